# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Defaults have one home: the shipped parameter file and every check follow from the dataclasses. The documents
name files that exist, and the code keeps the rules that a reader relies on. The vocabulary: keypoint layouts,
spellings of joint names, and errors of one printable line."""

import ast
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros import skeleton as module
from mocap_ros.cli.main import COMMANDS
from mocap_ros.config import Config, from_yaml, load_yaml, parameters, to_yaml, values, with_values, yaml_file
from mocap_ros.errors import MAX_MESSAGE_CHARACTERS, ConfigError, InputError, SkeletonError
from mocap_ros.skeleton import CMU15, LAYOUT_NAMES, canonical_joint_names, keypoint_layout
from tests.support.paths import ROOT

SHIPPED = ROOT / 'config' / 'mocap_ros.yaml'


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


PACKAGE = ROOT / 'mocap_ros'
PAGES = [*ROOT.glob('*.md'), *ROOT.glob('docs/*.md')]
MODULES = sorted(PACKAGE.rglob('*.py'))


def test_every_file_that_the_architecture_names_exists() -> None:
    text = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
    paths = re.findall(r'`([a-z0-9_]+(?:/[a-z0-9_]+)*(?:\.py|/))`', text)
    assert paths
    for path in paths:
        places = [PACKAGE / path, ROOT / path, *PACKAGE.glob(f'*/{path}')]
        assert any(p.exists() for p in places), path


def anchors(page: Path) -> set[str]:
    text = re.sub(r'^```.*?^```', '', page.read_text(encoding='utf-8'), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r'^#+ (.*)$', text, re.MULTILINE)
    return {re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target, anchor in re.findall(r'\]\(([^)#\s]*)#?([^)\s]*)\)', page.read_text(encoding='utf-8')):
        if '://' not in target:
            path = page.parent / target if target else page
            assert path.exists(), f'{page.name}: {target}'
            assert not anchor or anchor in anchors(path), f'{page.name}: {target}#{anchor}'


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_every_parameter_and_command_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding='utf-8').split('## 0.1.0')[0]
    known = {parameter.name for parameter in parameters()}
    groups = '|'.join({name.partition('.')[0] for name in known})
    assert set(re.findall(rf'(?:`|-p |--set )((?:{groups})\.[a-z_]+)', text)) <= known
    assert set(re.findall(r'mocap-ros ([a-z]+)', text)) <= {*COMMANDS, 'plot'}, 'the changelog names `plot`'


def test_every_page_is_in_the_table_of_contents_of_the_site() -> None:
    listed = (ROOT / 'docs' / 'index.rst').read_text(encoding='utf-8').split()
    assert {page.stem for page in PAGES if page.parent.name == 'docs'} - set(listed) == set()


@pytest.mark.parametrize('module', MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_every_number_among_the_constants_has_a_comment(module: Path) -> None:
    """A comment on the line of the constant, or above its block, gives unit and reason; options have help."""
    text = module.read_text(encoding='utf-8')
    lines = text.split('\n')
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        numbers = [n for n in ast.walk(node) if isinstance(n, ast.Constant) and type(n.value) in (int, float)]
        if not numbers or not any(name[0] != '_' and name.isupper() for name in {*names} - {'OPTIONS'}):
            continue
        inside = any('#' in line for line in lines[node.lineno - 1 : node.end_lineno])
        block = '\n'.join(lines[: node.lineno - 1]).rpartition('\n\n')[2]
        is_commented = inside or block.startswith('#') or lines[node.lineno - 2].startswith('#')
        assert is_commented, f'{module.name}:{node.lineno}: {names[0]} has neither unit nor reason'


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_layout_is_a_forest_with_left_and_right(name: str) -> None:
    skeleton = keypoint_layout(name)
    assert len(set(skeleton.joints)) == len(skeleton.joints)
    assert len(skeleton.outward_bones()) == len(skeleton.bones)
    mirror = np.array(skeleton.mirror)
    assert (mirror[mirror] == np.arange(len(mirror))).all()
    for left, right in skeleton.left_right_pairs:
        assert mirror[left] == right
        assert re.sub('^l|_l$', '', skeleton.joints[left]) == re.sub('^r|_r$', '', skeleton.joints[right])
        assert skeleton.joints[left] != re.sub('^l|_l$', '', skeleton.joints[left])
    assert {'lshoulder', 'rankle'} <= set(skeleton.joints)


def test_unknown_layout_error_lists_known_layouts() -> None:
    with pytest.raises(SkeletonError, match=r"'xyz'.*coco17.*mediapipe33"):
        keypoint_layout('xyz')
    with pytest.raises(SkeletonError, match=r"'coc17'; did you mean 'coco17'\?$"):
        keypoint_layout('coc17')
    with pytest.raises(SkeletonError, match=r"'coco'; did you mean 'coco17' or 'coco18'\?$"):
        keypoint_layout('coco')


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_canonical_names_are_unchanged_and_other_spellings_converted(name: str) -> None:
    joints = keypoint_layout(name).joints
    assert canonical_joint_names(joints) == joints
    sides = {'l': 'left', 'r': 'right'}
    pairs = {
        joints[i]
        for pair in keypoint_layout(name).left_right_pairs
        for i in pair
        if not joints[i].endswith(('_l', '_r'))
    }
    for spell in (
        lambda side, rest: f'{sides[side]}_{rest}',
        lambda side, rest: f'{sides[side]}-{rest}'.upper(),
        lambda side, rest: f'{side}_{rest}',
        lambda side, rest: sides[side].title() + rest.title().replace('_', ''),
        lambda side, rest: side.upper() + rest.title(),
    ):
        assert canonical_joint_names([spell(j[0], j[1:]) if j in pairs else j for j in joints]) == joints


def test_names_of_well_known_detectors_are_converted() -> None:
    given = ['leftEyeInner', 'left eye (outer)', 'mouth_left', 'MidHip', 'RBigToe', 'left_foot_index', 'Tail']
    canonical = ('leye_inner', 'leye_outer', 'mouth_l', 'pelvis', 'rbigtoe', 'lfoot_index', 'Tail')
    assert canonical_joint_names(given) == canonical


def test_the_stature_follows_from_the_mean_lengths_of_the_bones(rng: np.random.Generator) -> None:
    poses = rng.normal(size=(20, 15, 3))
    mean_lengths = CMU15.bone_lengths(poses).mean(axis=0)
    assert mean_lengths @ CMU15.stature_per_bone == pytest.approx(module.estimate_stature(poses, CMU15))
    with pytest.raises(SkeletonError, match="layout '' has no bone from lhip to lknee"):
        _ = module.skeleton_from_joints(CMU15.joints[::-1]).stature_per_bone


@pytest.mark.parametrize(
    ('message', 'shown'),
    [
        ('a.npz: Zoë: 5 px', 'a.npz: Zoë: 5 px'),
        ('a\n  b\tc', 'a b c'),
        ('\x1b[2Ja\x07\u202eb\ud800', r'\x1b[2Ja\x07\u202eb\ud800'),
    ],
)
def test_a_message_is_one_printable_line(message: str, shown: str) -> None:
    error = InputError(message)
    assert str(error) == shown
    assert str(pickle.loads(pickle.dumps(error))) == shown


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    for fill in ('x', '\x00'):
        text = str(InputError(f'a.json: {fill * 10**6} is no name'))
        assert len(text) <= MAX_MESSAGE_CHARACTERS
        assert text.startswith('a.json: ')
    assert str(InputError(f'a.json: {"x" * 10**6} is no name')).endswith('x is no name')
