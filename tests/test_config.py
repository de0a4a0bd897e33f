"""One home for defaults: the shipped YAML and every check follow from the dataclasses."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.config import Config, from_yaml, parameters, to_yaml, values, with_values
from mocap_ros.errors import ConfigError

SHIPPED = Path(__file__).parents[1] / 'config' / 'mocap_ros.yaml'


def test_shipped_parameter_file_is_the_defaults() -> None:
    assert SHIPPED.read_text(encoding='utf-8') == to_yaml(Config()), (
        'run: mocap-ros config > config/mocap_ros.yaml'
    )


def test_every_parameter_is_described_and_its_default_is_valid() -> None:
    for p in parameters():
        assert p.doc
        assert p.check(p.default) == p.default


def test_yaml_round_trip() -> None:
    config = with_values(Config(), {'solver.bone_weight': 3, 'tracker.model': 'walk', 'node.autostart': False})
    assert from_yaml(to_yaml(config), 'x') == config
    assert from_yaml('solver: {components: 7}', 'x').solver.components == 7
    assert from_yaml('', 'x') == Config()


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('solver: {bone_wait: 1}', r"f\.yaml: unknown parameter 'solver\.bone_wait'"),
        ('solver: {components: many}', r'solver\.components = .many.: expected a int'),
        ('solver: {components: 0}', r'solver\.components = 0: expected 1 to 60'),
        ('solver: {bone_weight: .nan}', r'solver\.bone_weight = nan'),
        ('solver: {method: magic}', r'expected joint, alternation'),
        ('[1, 2]', 'expected a mapping'),
        ('{', r'f\.yaml: not YAML'),
        ('!!python/object/apply:os.system [true]', 'not YAML'),
    ],
)
def test_bad_files_say_what_and_where(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        from_yaml(text, 'f.yaml')


@given(st.sampled_from(sorted(values(Config()))), st.one_of(st.none(), st.integers(), st.floats(), st.text()))
def test_any_value_is_taken_or_refused_by_name(name: str, value: object) -> None:
    parameter = next(p for p in parameters() if p.name == name)
    try:
        parameter.check(value)
    except ConfigError:
        with pytest.raises(ConfigError, match=name):
            with_values(Config(), {name: value})
    else:
        config = with_values(Config(), {name: value})
        assert from_yaml(to_yaml(config), 'x') == config
