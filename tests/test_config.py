# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Defaults have one home: the shipped parameter file and every check follow from the dataclasses."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.config import Config, from_yaml, load_yaml, parameters, to_yaml, values, with_values, yaml_file
from mocap_ros.errors import ConfigError

SHIPPED = Path(__file__).parents[1] / 'config' / 'mocap_ros.yaml'


def test_shipped_parameter_file_holds_the_defaults() -> None:
    shipped = SHIPPED.read_text(encoding='utf-8')
    assert shipped == to_yaml(Config(), shows_all=False), 'run: mocap-ros config > config/mocap_ros.yaml'


def test_every_parameter_is_described_and_its_default_is_valid() -> None:
    for parameter in parameters():
        assert parameter.description
        assert parameter.check(parameter.default) == parameter.default


def test_yaml_round_trip() -> None:
    config = with_values(Config(), {'tracker.window': 3, 'tracker.model': 'walk', 'node.autostart': False})
    assert from_yaml(to_yaml(config), 'x') == config
    assert from_yaml('solver: {max_iterations: 7}', 'x').solver.max_iterations == 7
    for empty in ('', 'solver:\n', 'mocap_node:\n  ros__parameters:\n', 'solver:\ntracker: {}'):
        assert from_yaml(empty, 'x') == Config()
    for path in ('long ' * 50, 'a\nb', '\x85 \u2028 \x1f' + '\U00010000' * 7, "it's: #", ''):
        named = with_values(Config(), {'tracker.model': path})
        assert from_yaml(to_yaml(named), 'x') == named


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('solver: {bone_weight: 1}', r"f\.yaml: unknown parameter 'solver\.bone_weight'"),
        ('solver: 3', r"f\.yaml: solver: is a group of parameters; names are dotted, such as 'solver\.\w+'"),
        ('tracker: {components: 90}', r'tracker\.components = 90: expected 1 to 40'),
        ('tracker: {components: many}', r'tracker\.components = .many.: expected an int'),
        ('tracker: {window: 1e-5x}', r"tracker\.window = '1e-5x': expected a float"),
        ('tracker: {window: true}', r'tracker\.window = True: expected a float'),
        ("node: {queue: '1e1'}", r"node\.queue = '1e1': expected an int"),
        ('node: {queue: 10.0}', r'node\.queue = 10\.0: expected an int'),
        ('node: {queue: true}', r'node\.queue = True: expected an int'),
        ('node: {publish_tf: 1}', r'node\.publish_tf = 1: expected a bool'),
        ('recorder: {folder: 1}', r'recorder\.folder = 1: expected a str'),
        ('tracker: {components: 0}', r'tracker\.components = 0: expected 1 to 40'),
        ('tracker: {window: .nan}', r'tracker\.window = nan'),
        ('solver: {method: magic}', r'expected joint, alternation'),
        ('[1, 2]', 'expected a mapping'),
        ('{', r'f\.yaml: not YAML'),
        ('!!python/object/apply:os.system [true]', 'not YAML'),
        ('{a: ' * 2000, r'f\.yaml: not YAML: line 1: nested too deep'),
        ('a: &a [1]\nb: *a', r'f\.yaml: not YAML: line 2: aliases are not allowed'),
        ('solver: {components: 3}\nsolver: {}', r"line 2: the key 'solver' occurs twice"),
        ('1: 2', 'line 1: a key is not text'),
        ('[1]: 2', 'line 1: a key is not text'),
        ('solver: {components: 2001-99-99}', 'not YAML: month'),
        ('false', 'expected a mapping'),
        (f'tracker: {{components: 1{"0" * 400}}}', r'tracker\.components = 10+\.\.\.: expected 1 to 40'),
        (f'tracker: {{window: 1{"0" * 400}}}', r'tracker\.window = 10+\.\.\.: expected 0\.1 to 20'),
        (f'tracker: {{components: 0x{"f" * 5000}}}', r'tracker\.components = a huge value'),
    ],
)
def test_errors_in_a_file_name_the_file_and_the_place(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        from_yaml(text, 'f.yaml')


def test_a_number_may_be_given_for_a_text_of_numbers() -> None:
    given = {'node.floor_height': 0, 'node.prediction_times': 0.5}
    node = with_values(Config(), given).node
    assert (node.floor_height, node.prediction_times) == ('0', '0.5')
    with pytest.raises(ConfigError, match=r'node\.output_frame = 5: expected a str'):
        with_values(Config(), {'node.output_frame': 5})


@pytest.mark.parametrize(('text', 'value'), [('2e-1', 0.2), ('2E+0', 2.0), ('3', 3.0), ('0.25', 0.25)])
def test_a_number_in_any_notation_of_yaml_is_a_number(text: str, value: float) -> None:
    """YAML 1.1 reads a number without a point before its exponent as a text."""
    found = from_yaml(f'tracker: {{window: {text}}}', 'test').tracker.window
    assert (found, type(found)) == (value, float)
    assert with_values(Config(), {'recorder.folder': text}).recorder.folder == text, 'where a text is expected'


yaml_like = st.text('ab:{}[]&*!- \n\'"|>?%@1.,#~x', max_size=30)


def test_a_text_of_very_many_values_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_file, 'MAX_NODES', 100)
    assert load_yaml('a: [' + '1,' * 90 + ']', 'f.yaml') == {'a': [1] * 90}
    with pytest.raises(ConfigError, match=r'f\.yaml: not YAML: line 1: more than 100 keys and values'):
        load_yaml('a: [' + '1,' * 100 + ']', 'f.yaml')


@given(st.one_of(st.text(max_size=30), yaml_like))
def test_any_text_is_a_configuration_or_an_error_that_names_the_file(text: str) -> None:
    try:
        assert from_yaml(text, 'f.yaml') == Config()
    except ConfigError as error:
        assert str(error).startswith('f.yaml: ')  # noqa: PT017


@given(st.sampled_from(sorted(values(Config()))), st.one_of(st.none(), st.integers(), st.floats(), st.text()))
def test_any_value_is_valid_or_an_error_that_names_the_parameter(name: str, value: object) -> None:
    parameter = next(p for p in parameters() if p.name == name)
    try:
        parameter.check(value)
    except ConfigError:
        with pytest.raises(ConfigError, match=name):
            with_values(Config(), {name: value})
    else:
        config = with_values(Config(), {name: value})
        assert from_yaml(to_yaml(config), 'x') == config
