# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files for RViz, Foxglove, `ros2 launch` and SROS2 name topics, fields, parameters and rights that there are;
what the node reports: its diagnostic status, and a log that is not flooded."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from itertools import islice
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.bridges.bridge import CONSUMERS
from mocap_ros.config import Config, RecorderConfig, values, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.findings import Fault, Grade
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import encode_skeletons
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.diagnostics import DIAGNOSTICS, DiagnosticsReporter, Level, RunStatistics
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.ros.throttled_log import MAX_KINDS, MAX_REASONS, ThrottledLog
from mocap_ros.runtime.outputs import OUTPUTS, SWITCHED_OUTPUTS
from mocap_ros.runtime.pipeline import Pipeline
from tests.support.bodies import gather, make_person_3d
from tests.support.camera_messages import camera_info, encode, make_transforms
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import FAST_CONFIG, LineLog, encode_demo_frames, process, with_stamp
from tests.support.ros_node import Peer, StartNode, StartProgram, keypoints_at

POLICY_PATH = ROOT / 'config' / 'mocap_ros.policy.xml'


class Permissions(NamedTuple):
    """Names of topics and services, as the policies write them, that a node may use."""

    publish: frozenset[str]
    subscribe: frozenset[str]
    reply: frozenset[str]
    request: frozenset[str]


def read_permissions(node: str) -> Permissions:
    profile = ET.parse(POLICY_PATH).find(f'.//profile[@node="{node}"]')
    assert profile is not None
    kinds = {'publish': 'topic', 'subscribe': 'topic', 'reply': 'service', 'request': 'service'}
    lists = (profile.findall(f'{kind}s[@{permission}="ALLOW"]/{kind}') for permission, kind in kinds.items())
    return Permissions(*(frozenset(element.text or '' for element in elements) for elements in lists))


BODIES = '/humans/bodies/*'  # topics of single bodies, with types that are not installed
OF_EVERY_NODE = {'/parameter_events'}  # rclpy subscribes to it only where the time of a simulation is used


def is_installed(kind: str) -> bool:
    try:
        load_interface_class(kind)
    except ConfigError:
        return False
    return True


def find_permissions(node: Any, name: str) -> Permissions:
    """Return what another node has on the middleware, with names as in the policies."""

    def rename(found: list[tuple[str, list[str]]]) -> frozenset[str]:
        allowed = {name for names in read_permissions(name) for name in names}
        own = {topic.replace(f'/{name}/', '~/') for topic, _ in found}
        return frozenset(topic[1:] if topic[1:] in allowed else topic for topic in own)

    return Permissions(
        publish=rename(node.get_publisher_names_and_types_by_node(name, '/')),
        subscribe=rename(node.get_subscriber_names_and_types_by_node(name, '/')),
        reply=rename(node.get_service_names_and_types_by_node(name, '/')),
        request=rename(node.get_client_names_and_types_by_node(name, '/')),
    )


def without(permissions: Permissions, missing: set[str]) -> Permissions:
    """Return the permissions that do not need types that are not installed."""
    return permissions._replace(
        publish=permissions.publish - missing, subscribe=permissions.subscribe - missing - OF_EVERY_NODE
    )


def wait_for_permissions(peer: Peer, name: str, missing: set[str]) -> None:
    """Wait until a node has on the middleware what the policies allow; it must never have more."""
    allowed = read_permissions(name)
    expected = without(allowed, missing)

    def are_reached() -> bool:
        found = find_permissions(peer.node, name) if name in peer.node.get_node_names() else None
        if found is None:
            return False
        for mine, others in zip(found, allowed, strict=True):
            assert mine <= others, 'not allowed'
        return without(found, set()) == expected

    peer.wait_until(are_reached)


@pytest.mark.ros
def test_the_node_has_what_the_policies_allow(peer: Peer, start_node: StartNode) -> None:
    wanted = dict(SWITCHED_OUTPUTS.values()) | {'/tf_static': TRANSFORMS}
    bodies = {BODIES, '/humans/bodies/tracked'}  # inputs of another type
    missing = {*bodies, *(topic for topic, kind in wanted.items() if not is_installed(kind))}
    assert 'predictions' not in missing
    switches = [f'node.{field}:=true' for field in SWITCHED_OUTPUTS]
    start_node('node.output_frame:=map', 'use_sim_time:=true', *switches)
    wait_for_permissions(peer, 'mocap_node', missing)


@pytest.mark.ros
def test_the_player_has_what_the_policies_allow(peer: Peer, start: StartProgram, tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), 0, 0)
        for i in range(10):
            recorder.write('/keypoints', KEYPOINTS, keypoints_at(i), i * 10**8, i * 10**8)
    start(sys.executable, '-m', 'mocap_ros.cli.main', 'play', tmp_path / 'bag', '--loop', '--clock')
    missing = {BODIES, '/humans/bodies/tracked', 'imu', '/tf', '/tf_static'}  # they are not in this bag
    wait_for_permissions(peer, 'mocap_player', missing)


CONFIG = ROOT / 'config'


def test_rviz_shows_outputs_of_the_node() -> None:
    # Message type that a display of RViz shows.
    types = {'MarkerArray': 'visualization_msgs/msg/MarkerArray', 'PointCloud2': 'sensor_msgs/msg/PointCloud2'}
    displays = yaml.safe_load((CONFIG / 'mocap_ros.rviz').read_text())['Visualization Manager']['Displays']
    shown = {d['Topic']['Value']: d['Class'].rpartition('/')[2] for d in displays if 'Topic' in d}
    assert shown.keys() == {'markers', 'points'}
    assert {topic: types[display] for topic, display in shown.items()} == {t: OUTPUTS[t] for t in shown}


def test_foxglove_shows_fields_of_outputs_of_the_node() -> None:
    layout = json.loads((CONFIG / 'mocap_ros.foxglove.json').read_text())
    panels = layout['configById']
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(layout['layout']))) == panels.keys(), 'each panel has a place'
    assert {topic.removeprefix('/') for topic in panels['3D!people']['topics']} <= OUTPUTS.keys()
    assert panels['DiagnosticSummary!node']['topicToRender'] == '/diagnostics'
    paths = [p['value'] for p in panels['Plot!residual']['paths']]
    skeletons = decode(
        encode_skeletons(Header(1, 'camera'), gather([make_person_3d('anna')])), OUTPUTS['skeletons']
    )
    for path in (*paths, panels['RawMessages!skeletons']['topicPath']):
        field = re.fullmatch(r'/skeletons\.people\[:\]\.(\w+)', path)
        assert field, path
        assert hasattr(skeletons.people[0], field[1]), path


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
    inputs = {Source.KEYPOINTS.value, Source.CAMERA_INFO.value, Source.IMU.value}
    assert {topic for topic, _ in node.remappings} == inputs
    assert all(substitution.args == (topic,) for topic, substitution in node.remappings)
    (node,) = launch_file.create_nodes({**dict.fromkeys(declared, ''), 'record': 'true'})
    _, given = node.parameters
    types = {name: (v.args[0].args[0], v.value_type) for name, v in given.items()}
    assert types == {'recorder.enabled': ('record', bool)}


def test_the_launch_file_finds_the_files_that_are_installed(launch_file: ModuleType) -> None:
    (description,) = launch_file.generate_launch_description().args
    (rviz,) = (a for a in description if getattr(a, 'executable', '') == 'rviz2')
    parameter_file, _ = launch_file.ARGUMENTS['params_file']
    for substitution in (parameter_file, rviz.arguments[1]):
        ((share, *parts),) = substitution.args
        assert share.args == ('mocap_ros',)
        assert Path(ROOT, *parts).is_file()


NODE_TOPICS = {'/parameter_events', '/rosout'}  # of every node, which rclpy creates
OWN_SERVICES = {'~/record', '~/reset'}  # of `mocap_node`, besides those of every lifecycle node


def test_the_bridge_may_do_what_it_does() -> None:
    bridge = read_permissions('mocap_bridge')
    topics = {consumer.topic for consumer in CONSUMERS.values()}
    assert bridge.publish == {*topics, *NODE_TOPICS, BODIES, '~/transition_event'}
    assert bridge.subscribe == {'skeletons', 'predictions', '/clock', '/parameter_events'}
    assert bridge.reply == read_permissions('mocap_node').reply - OWN_SERVICES
    assert not bridge.request


def test_the_operator_calls_services_of_the_node_and_reads_what_it_says() -> None:
    operator, node = read_permissions('operator'), read_permissions('mocap_node')
    called = {name.replace('/mocap_node', '~') for name in operator.request}
    assert {*OWN_SERVICES, '~/change_state', '~/get_state', '~/set_parameters'} <= called <= node.reply
    assert operator.subscribe == {'/diagnostics', 'skeletons', '/parameter_events'}
    assert operator.publish == NODE_TOPICS
    assert not operator.reply


GOOD, NO_PEOPLE = (Level.OK, '1 people'), (Level.OK, '0 people')


@pytest.fixture(autouse=True)
def _time_stands_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.diagnostics.time', SimpleNamespace(monotonic=lambda: 100.0))


class Run:
    """A pipeline and its statistics, in which one message was received and none was processed."""

    def __init__(self, **values: object) -> None:
        config = with_values(FAST_CONFIG, {name.replace('__', '.'): value for name, value in values.items()})
        self.pipeline, self.statistics = Pipeline(config), RunStatistics()
        self.reporter = DiagnosticsReporter('mocap_node', self.pipeline, self.statistics)
        self.values: dict[str, str] = {}  # of the newest report
        self.frames = iter(encode_demo_frames(9))
        self.statistics.record_receipt()

    def feed(self, *messages: bytes) -> None:
        for raw in messages:
            self.pipeline.feed(Source.KEYPOINTS, raw)

    def process(self) -> None:
        process(self.pipeline, next(self.frames))

    def report(self, fault: str = '') -> tuple[int, str]:
        (status,) = decode(self.reporter.encode_status('off', 10**9, fault), DIAGNOSTICS).status
        self.values = {v.key: v.value for v in status.values}
        assert status.name == 'mocap_node'
        return status.level, status.message


def refuse(run: Run) -> None:
    run.feed(next(run.frames)[:50])
    run.pipeline.note_backlog()
    run.process()


def refuse_camera_info(run: Run) -> None:
    run.pipeline.feed(Source.CAMERA_INFO, b'')


def repeat_a_stamp(run: Run) -> None:
    run.statistics.record_receipt()
    run.feed(*[next(run.frames)] * 3)


def refuse_all(run: Run) -> None:
    for _ in range(3):
        run.statistics.record_receipt()
        run.feed(b'')


def see_too_little(run: Run) -> None:
    message = decode(next(run.frames), KEYPOINTS)
    message.people[0].score = np.full_like(message.people[0].score, 0.05)
    run.feed(encode(message, KEYPOINTS))


def warn_of_input(run: Run) -> None:
    run.process()
    words = 'people: most points lie outside the image'
    run.pipeline.checks.findings = [Fault.OTHER.found(Grade.DOUBTFUL, words=words)]


PROBLEMS = [
    (lambda run: vars(run.statistics).update(removed=7), Level.WARN, '7 removed from a full queue'),
    (refuse, Level.WARN, '1 invalid, 1 skipped because of a backlog in the last second'),
    (lambda run: run.pipeline.counters.dropped.update({'internal error': 2}), Level.ERROR, '2 internal errors'),
    (refuse_camera_info, Level.WARN, '1 invalid in the last second'),
    (repeat_a_stamp, Level.WARN, '2 dropped for their stamps in the last second'),
    (refuse_all, Level.ERROR, 'no message was accepted: 3 invalid in the last second'),
    (see_too_little, Level.WARN, '1 detections were no person in the last second: '),
    (warn_of_input, Level.WARN, 'people: most points lie outside the image'),
]


@pytest.mark.parametrize(('cause', 'level', 'message'), PROBLEMS, ids=lambda p: getattr(p, '__name__', ''))
def test_a_problem_is_reported_in_the_second_in_which_it_occurs(cause: Any, level: Level, message: str) -> None:
    run = Run()
    run.process()
    assert run.report() == GOOD
    cause(run)
    found, text = run.report()
    assert (found, text.startswith(message)) == (level, True), text
    assert run.report() == NO_PEOPLE, 'of an earlier second'
    again = Run()
    cause(again)
    again.reporter = DiagnosticsReporter('mocap_node', again.pipeline, again.statistics)
    assert again.report() == NO_PEOPLE, 'of an earlier run'


def test_no_input_makes_the_status_stale_and_the_time_may_change(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run(node__silence_warning=60.0)
    assert RunStatistics().seconds_since_input() == np.inf
    monkeypatch.setattr(run.statistics, 'seconds_since_input', lambda: 10.0)
    assert run.report()[0] == Level.OK
    run.pipeline.reconfigure(with_values(run.pipeline.config, {'node.silence_warning': 5.0}))
    assert run.report() == (Level.STALE, 'no input')


def test_the_newest_reason_is_reported_once_and_is_one_short_printable_line() -> None:
    run = Run()
    refuse_camera_info(run)
    run.statistics.reason = '/keypoints: people[0].x:\n\x1b' + ' ' + 'looks normalised ' * 99
    _, message = run.report()
    assert '1 invalid in the last second; /keypoints: people[0].x: \\x1b looks normalised looks' in message
    assert len(message) < 500
    refuse_camera_info(run)
    assert run.report() == (Level.WARN, '1 invalid in the last second')


def test_the_values_are_those_of_the_run() -> None:
    run = Run()
    assert run.report() == NO_PEOPLE
    assert run.values['age of newest frame (s)'] == 'nan'
    process(run.pipeline, with_stamp(next(run.frames), 400_000_000))
    run.statistics.removed += 7
    for milliseconds in range(1, 101):
        run.statistics.record_receipt()
        run.statistics.solve_seconds.append(milliseconds / 1e3)
    run.statistics.lost += 3
    run.report()
    found = {key: float(value) for key, value in run.values.items() if key[-1] == ')'}
    expected = {
        'input rate (Hz)': 50.5,  # 101 messages in the last 2 s
        'solve time p50 (ms)': 50.5,
        'solve time p99 (ms)': 99.0,
        'residual (px)': run.pipeline.people[0].reprojection_residual,
        'age of newest frame (s)': 0.6,
    }
    assert found == pytest.approx(expected, abs=0.1, nan_ok=True)
    names = 'people', 'category', 'focal length', 'recorder', 'lost before the node', 'dropped: queue full'
    assert [run.values[name] for name in names] == ['1', 'walk', 'nominal', 'off', '3', '7']
    run.pipeline.reset()
    run.report()
    emptied = 'people', 'category', 'residual (px)', 'age of newest frame (s)'
    assert [run.values[key] for key in emptied] == ['0', '', 'nan', 'nan']


def test_the_summary_says_what_is_going_on_now() -> None:
    run = Run()
    run.feed(*islice(run.frames, 8), *[b''] * 40)
    run.report()
    assert run.values['summary'].startswith('doubtful: the last 40 messages were refused; ')
    run.process()
    run.report()
    assert run.values['summary'].startswith('doubtful: 40 of 49 messages were refused; ')


def test_people_in_the_frame_of_the_camera_instead_of_the_output_frame_are_a_warning() -> None:
    run = Run(node__output_frame='map')
    next(run.frames)  # its stamp is 0, as if there was none
    assert run.report() == NO_PEOPLE  # before the first image
    run.process()
    level, message = run.report()
    assert level == Level.WARN
    assert "the frame of the camera, 'camera', as the transform to node.output_frame, 'map', is unknown" in message
    assert run.values['frame of people'] == 'camera'
    run.pipeline.feed(Source.STATIC_TRANSFORMS, make_transforms(('map', 'camera', 0, (1, 0, 0))))
    run.process()
    assert run.report() == GOOD
    assert run.values['frame of people'] == 'map'


@pytest.mark.parametrize(
    ('topic', 'reason', 'count'),
    [
        ('/keypoints', 'people[0].x[3]: {1}', MAX_REASONS + 3),  # 1st to 5th, 10th, 100th, 1000th
        ('/keypoints', "people[0].skeleton: unknown keypoint layout 'x{0}'; known: a", MAX_REASONS + 3),
        ('/humans/bodies/b{1}/skeleton2d', 'the same of every body', 4),
        ('/keypoints', 'a kind of its own: {0}', MAX_KINDS + MAX_REASONS + 2),
    ],
)
def test_the_log_is_not_flooded(topic: str, reason: str, count: int) -> None:
    log = LineLog()
    throttled = ThrottledLog(log)
    for i in range(1000):
        throttled.report(topic.format(chr(500 + i), i), i, reason.format(chr(500 + i), i))
    assert len(log.lines) == count
    throttled.report('/camera_info', 1, 'another topic')
    assert log.lines[-1] == 'error /camera_info: message 1: another topic'
