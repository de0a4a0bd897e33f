# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files for RViz, Foxglove, `ros2 launch` and SROS2 name topics, types, fields and parameters that there are."""

import json
import re
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from mocap_ros.bags.topics import Source
from mocap_ros.bridges.bridge import CONSUMERS
from mocap_ros.config import Config, values
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.skeletons import encode_skeletons
from mocap_ros.ros.help import BRIDGE_NAME, BRIDGE_PARAMETERS
from mocap_ros.runtime.outputs import OUTPUTS
from tests.support.launch_file import load_launch_file, read_permissions
from tests.support.paths import ROOT
from tests.support.people import make_person_3d

CONFIG = ROOT / 'config'
# Message type that a display of RViz shows.
DISPLAY_TYPES = {'MarkerArray': 'visualization_msgs/msg/MarkerArray', 'PointCloud2': 'sensor_msgs/msg/PointCloud2'}


def test_rviz_shows_outputs_of_the_node() -> None:
    displays = yaml.safe_load((CONFIG / 'mocap_ros.rviz').read_text())['Visualization Manager']['Displays']
    shown = {d['Topic']['Value']: d['Class'].rpartition('/')[2] for d in displays if 'Topic' in d}
    assert shown.keys() == {'markers', 'points'}
    assert {topic: DISPLAY_TYPES[display] for topic, display in shown.items()} == {t: OUTPUTS[t] for t in shown}


def test_foxglove_shows_fields_of_outputs_of_the_node() -> None:
    layout = json.loads((CONFIG / 'mocap_ros.foxglove.json').read_text())
    panels = layout['configById']
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(layout['layout']))) == panels.keys(), 'each panel has a place'
    assert {topic.removeprefix('/') for topic in panels['3D!people']['topics']} <= OUTPUTS.keys()
    assert panels['DiagnosticSummary!node']['topicToRender'] == '/diagnostics'
    paths = [p['value'] for p in panels['Plot!residual']['paths']]
    skeletons = decode(encode_skeletons(Header(1, 'camera'), [make_person_3d('anna')]), OUTPUTS['skeletons'])
    for path in (*paths, panels['RawMessages!skeletons']['topicPath']):
        field = re.fullmatch(r'/skeletons\.people\[:\]\.(\w+)', path)
        assert field, path
        assert hasattr(skeletons.people[0], field[1]), path


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return load_launch_file(monkeypatch)


def test_the_launch_file_starts_the_node_with_parameters_and_topics_that_it_has(launch_file: ModuleType) -> None:
    (description,) = launch_file.generate_launch_description().args
    declared = {a.args[0]: a.default_value for a in description if hasattr(a, 'default_value')}
    assert declared.keys() == launch_file.ARGUMENTS.keys()
    known = values(Config())
    for name, (parameter, kind) in launch_file.PARAMETERS.items():
        assert declared[name] == '', 'an argument that is not given leaves the parameter as the file has it'
        assert type(known[parameter]) is kind
    (node,) = launch_file.create_nodes(dict.fromkeys(declared, ''))
    assert (node.package, node.executable, node.name) == ('mocap_ros', 'mocap_node', 'mocap_node')
    assert [p.args[0] for p in node.parameters] == ['params_file']
    assert {topic for topic, _ in node.remappings} == {Source.KEYPOINTS.value, Source.CAMERA_INFO.value}
    assert all(substitution.args == (topic,) for topic, substitution in node.remappings)
    (node,) = launch_file.create_nodes({**dict.fromkeys(declared, ''), 'record': 'true'})
    _, given = node.parameters
    assert {name: (v.args[0].args[0], v.value_type) for name, v in given.items()} == {
        'recorder.enabled': ('record', bool)
    }


def test_the_launch_file_starts_the_bridge_with_one_argument(launch_file: ModuleType) -> None:
    context = {**dict.fromkeys(launch_file.ARGUMENTS, ''), 'bridge': 'people prediction_markers'}
    node, bridge = launch_file.create_nodes(context)
    assert (bridge.package, bridge.executable, bridge.name) == ('mocap_ros', BRIDGE_NAME, BRIDGE_NAME)
    (given,) = bridge.parameters
    assert {name: (v.args[0], v.value_type) for name, v in given.items()} == {
        'publish': ('people prediction_markers', str)
    }
    assert given.keys() <= {p.name for p in BRIDGE_PARAMETERS}
    assert node.parameters[1] == {'node.publish_predictions': True}


def test_the_launch_file_finds_the_files_that_are_installed(launch_file: ModuleType) -> None:
    (description,) = launch_file.generate_launch_description().args
    (rviz,) = (a for a in description if getattr(a, 'executable', '') == 'rviz2')
    parameter_file, _ = launch_file.ARGUMENTS['params_file']
    for substitution in (parameter_file, rviz.arguments[1]):
        ((share, *parts),) = substitution.args
        assert share.args == ('mocap_ros',)
        assert Path(ROOT, *parts).is_file()


BODIES = f'{Source.BODY.value}/*'  # the topics of the bodies
# Topics and services of every node, and of lifecycle nodes, which rclpy creates.
NODE_TOPICS = {'/parameter_events', '/rosout'}
OF_PARAMETERS = {
    *('describe_parameters', 'get_parameter_types', 'get_parameters', 'list_parameters', 'set_parameters'),
    *('set_parameters_atomically', 'get_type_description'),
}
OF_LIFECYCLE = {
    *('change_state', 'get_available_states', 'get_available_transitions', 'get_state', 'get_transition_graph')
}
# What an operator needs to record, to forget people, to stop the node and to change its parameters.
OPERATED = {'record', 'reset', 'change_state', 'get_state', *OF_PARAMETERS} - {
    *('set_parameters_atomically', 'get_type_description')
}


def test_the_bridge_may_do_what_it_does() -> None:
    bridge = read_permissions('mocap_bridge')
    topics = {consumer.topic for consumer in CONSUMERS.values()}
    assert bridge.publish == {*topics, *NODE_TOPICS, BODIES, '~/transition_event'}
    assert bridge.subscribe == {'skeletons', 'predictions', '/clock', '/parameter_events'}
    assert bridge.reply == {f'~/{name}' for name in OF_PARAMETERS | OF_LIFECYCLE}
    assert not bridge.request


def test_the_operator_calls_services_of_the_node_and_reads_what_it_says() -> None:
    operator, node = read_permissions('operator'), read_permissions('mocap_node')
    assert operator.request == {f'/mocap_node/{name}' for name in OPERATED}
    assert operator.request <= {name.replace('~', '/mocap_node') for name in node.reply}
    assert operator.subscribe == {'/diagnostics', 'skeletons', '/parameter_events'}
    assert operator.publish == NODE_TOPICS
    assert not operator.reply
