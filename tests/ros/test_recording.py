# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that the node records and the player plays: content, ends, replay, loop, clock, rate; subscriptions: QoS,
silence, topics of single bodies, and messages that do not arrive."""

import math
import re
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from itertools import islice
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2.metadata import parse_qos

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

from rclpy.qos import DurabilityPolicy, QoSProfile

from mocap_ros.bags.journal import INPUT, Acceptance, decode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.cli.main import main
from mocap_ros.config import Config, RecorderConfig, with_settings
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.cdr import Header, decode, typestore
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON
from mocap_ros.messages.imu import IMU
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.plain import encode_plain
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, encode_skeleton_definition
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.recordings.playback import PlaybackMessage, PlayedTopic, encode_sequence
from mocap_ros.ros import player
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.ros.player import Player
from mocap_ros.ros.qos import choose_playback_profile
from mocap_ros.ros.subscriptions import MAX_PUBLISHERS, InputSubscriptions, LostMessages
from mocap_ros.ros.topics import SilenceMonitor
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import CMU15
from tests.support.camera_messages import make_imu, make_transforms
from tests.support.pipeline_inputs import read_messages
from tests.support.ros_node import (
    RELIABLE_INPUT,
    TIMEOUT_S,
    Peer,
    StartNode,
    StartProgram,
    keypoints_at,
    stack_joints,
    stop_node,
    wait_until_discovered,
)

pytestmark = pytest.mark.ros

FRAMES = 40


def test_a_live_run_is_replayed(start: StartProgram, peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    sequence = make_recording().sequence()
    frames = list(islice(encode_sequence(sequence), FRAMES))
    with Recorder(tmp_path / 'played', RecorderConfig()) as recorder:
        for frame in frames:
            recorder.write('/detections', KEYPOINTS, frame.raw, frame.due_ns, frame.due_ns)

    # The machine may be busy, so that many messages wait.
    patient = ('node.queue:=100', 'qos_overrides./keypoints.subscription.depth:=100')
    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags', *patient)
    peer.wait_for_node()
    started, started_ns = time.monotonic(), time.time_ns()
    player = start(sys.executable, '-m', 'mocap_ros.cli.main', 'play', tmp_path / 'played')
    peer.wait_until(lambda: all(len(peer.received[t]) >= FRAMES for t in OUTPUTS))
    assert time.monotonic() - started > (FRAMES - 1) / 30
    out, _ = player.communicate(timeout=TIMEOUT_S)
    assert out.splitlines()[-1] == f'{tmp_path}/played: {FRAMES} messages published on keypoints'
    assert stop_node(node) == []
    peer.wait_until(peer.are_markers_deleted)
    for topic in OUTPUTS:
        assert peer.received_stamps(topic) == sequence.stamps_ns[:FRAMES]
    (definition,) = peer.received['skeleton_definition']
    assert decode(definition, SKELETON_DEFINITION).name == 'body26'

    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        recorded = {t: [m.raw for m in bag.messages(['/' + t])] for t in (*peer.received, 'keypoints')}
        times = [m.time_ns for m in bag.messages(bag.topics)]
    assert recorded.pop('keypoints') == [frame.raw for frame in frames]
    markers = peer.received['markers']
    del markers[: len(markers) - FRAMES - 1]  # the recording starts after all markers were deleted
    assert recorded == peer.received
    assert times == sorted(times)
    assert started_ns < times[-1] < time.time_ns()
    assert main(['replay', str(bag_folder), '-o', str(tmp_path / 'again')]) == 0
    replayed = read_messages(tmp_path / 'again', '/skeletons')
    assert len(replayed) == FRAMES
    np.testing.assert_allclose(stack_joints(replayed), stack_joints(recorded['skeletons']), atol=1e-9, rtol=0)


def test_accelerations_show_which_way_is_up_also_in_a_replay(
    peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    reliable = ('node.queue:=100', RELIABLE_INPUT, 'qos_overrides./imu.subscription.reliability:=reliable')
    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags', *reliable)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    static = peer.node.create_publisher(load_interface_class(TRANSFORMS), 'tf_static', latched)
    imu = peer.node.create_publisher(load_interface_class(IMU), 'imu', 100)
    peer.wait_for_node()
    for publisher in (static, imu, peer.keypoints):
        peer.wait_until(publisher.get_subscription_count)
    wait_until_discovered(peer.node, peer.executor, 'mocap_node')
    static.publish(make_transforms(('camera', 'imu', 0, (0.1, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))))  # upside down
    wait_until_discovered(peer.node, peer.executor, 'mocap_node')
    for number, frame in enumerate(islice(encode_sequence(make_recording().sequence()), 12), 1):
        for part in range(3):
            header = Header(frame.due_ns + part * 10_000_000, 'imu')
            imu.publish(make_imu(header, (0.1 * part, 9.7, 0.0) if number < 10 else (0.0, math.nan, 0.0)))
        wait_until_discovered(peer.node, peer.executor, 'mocap_node')  # which has then taken the accelerations
        peer.keypoints.publish(frame.raw)
        peer.wait_for_frames(number)
    (line,) = stop_node(node)
    assert 'linear_acceleration: 0, nan, 0 is not finite' in line

    (folder,) = (tmp_path / 'bags').iterdir()
    assert len(read_messages(folder, '/imu')) == 36
    for changes, is_same in (({}, True), ({'node.imu_pose': '0 0 0 -1.5708 0 -1.5708'}, False)):  # not upside down
        with Bag(folder) as bag:
            replay(bag, tmp_path / f'again_{is_same}', ReplayOptions(changes=changes))
        again = read_messages(tmp_path / f'again_{is_same}', '/skeletons')
        assert (again == peer.received['skeletons']) == is_same


def test_a_recording_ends_when_its_folder_is_removed(peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    node = start_node(f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    assert peer.set_parameter('recorder.enabled', True).successful
    peer.keypoints.publish(keypoints_at(1))
    peer.wait_for_frames(1)
    assert peer.set_parameter('recorder.enabled', False).successful
    (first,) = (tmp_path / 'bags').iterdir()
    with Bag(first) as bag:
        assert bag.count(['/keypoints']) == 1
        assert [q.history.name for q in bag.qos['/keypoints']] == ['UNKNOWN']  # discovery does not give it

    assert not peer.record(False).success
    assert peer.set_parameter('recorder.enabled', True).successful
    peer.wait_until(lambda: len(list((tmp_path / 'bags').glob('*/*.mcap'))) == 2)
    (second,) = set((tmp_path / 'bags').glob('*/*.mcap')) - set(first.iterdir())
    peer.wait_for_diagnostics('recorder', f'recording to {second.parent}')
    shutil.rmtree(second.parent)
    reason = f'{second}: the file was removed or moved while it was written'
    peer.wait_for_diagnostics('recorder', f'not recording: {reason}')
    assert not peer.record(False).success
    peer.wait_for_diagnostics('recorder', 'off')
    peer.keypoints.publish(keypoints_at(2))
    peer.wait_for_frames(2)
    (line,) = stop_node(node)
    assert re.search(r'removed or moved while it was written; the recording has ended, and the node', line)


def test_a_bag_is_complete_when_the_node_is_interrupted(peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    for frame in range(60):
        peer.keypoints.publish(keypoints_at(frame / 30))
        time.sleep(0.01)
        if frame == 50:
            node.send_signal(signal.SIGINT)
    assert node.wait(TIMEOUT_S) == 0
    peer.wait_for_end()
    skeletons, markers = peer.received['skeletons'], peer.received['markers']
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        assert [m.raw for m in bag.messages(['/skeletons'])] == skeletons
        later_markers = markers[-len(skeletons) - 1 :]  # the recording starts after a first deletion
        assert [m.raw for m in bag.messages(['/markers'])] == later_markers
        entries = [decode_entry(m.raw) for m in bag.messages(['/mocap_node/journal'])]
        acceptances = [entry.acceptance for entry in entries if entry.kind == INPUT]
        assert len(acceptances) == bag.count(['/keypoints']) <= 60
    assert len(skeletons) == acceptances.count(Acceptance.ACCEPTED)
    assert {*acceptances} <= {Acceptance.ACCEPTED, Acceptance.BACKLOG}


@pytest.mark.parametrize(
    ('options', 'reason'),
    [
        (['--wait', '0.3'], 'no subscriber to /keypoints '),
        (['--topic', '/people'], '--topic: '),
        (['--to', 'key points'], "--to 'key points': "),
    ],
)
def test_what_cannot_be_played_is_one_line(
    env: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], reason: str
) -> None:
    assert env['ROS_DOMAIN_ID']
    save_sequence(tmp_path / 'demo.npz', make_recording().sequence())
    assert main(['play', str(tmp_path / 'demo.npz'), *options]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f'mocap-ros: {reason}')


def test_all_topics_play_in_a_loop_with_clock_and_qos(start: StartProgram, peer: Peer, tmp_path: Path) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    bag, first_ns = tmp_path / 'bag', 5 * 10**9
    best_effort = {**make_topic('/keypoints', KEYPOINTS).qos[0], 'reliability': 'best_effort'}
    definition = encode_skeleton_definition(CMU15)
    with Recorder(bag, RecorderConfig()) as recorder:
        recorder.add_topic(make_topic('/keypoints', KEYPOINTS, qos=[best_effort]))
        recorder.declare_topic('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, definition, first_ns, first_ns)
        for i in range(10):
            recorder.write('/keypoints', KEYPOINTS, keypoints_at(i), first_ns + i * 10**8, first_ns)

    received: list[bytes] = []
    clocks: list[Any] = []
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    clock, keypoints = map(load_interface_class, ('rosgraph_msgs/msg/Clock', KEYPOINTS))
    peer.node.create_subscription(clock, '/clock', clocks.append, qos)
    peer.node.create_subscription(keypoints, '/keypoints', received.append, qos, raw=True)
    options = '--all', '--loop', '--clock', '--rate', '2'
    player = start(sys.executable, '-m', 'mocap_ros.cli.main', 'play', bag, *options)
    peer.wait_until(lambda: len(received) > 25 and len({c.clock.nanosec for c in clocks}) > 10)
    peer.wait_until(lambda: peer.received['skeleton_definition'])
    peer.wait_until(lambda: 'mocap_player' in peer.node.get_node_names())
    offered = peer.node.get_publishers_info_by_topic('/keypoints')
    reliability = {p.qos_profile.reliability for p in offered if p.node_name == 'mocap_player'}
    (latched,) = peer.node.get_publishers_info_by_topic('/skeleton_definition')
    player.send_signal(signal.SIGINT)
    out, err = player.communicate(timeout=TIMEOUT_S)

    assert (player.returncode, err) == (0, '')
    assert re.search(r'\d+ messages published on /keypoints, /skeleton_definition\n', out)
    assert reliability == {ReliabilityPolicy.BEST_EFFORT}
    assert latched.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert peer.received['skeleton_definition'][0] == definition
    assert {keypoints_at(i) for i in range(10)} >= set(received)
    times = [c.clock.sec + c.clock.nanosec / 1e9 for c in clocks]
    assert min(times) >= 5.0
    assert max(times) <= 5.9
    assert len(set(times)) > 10


POINT = 'geometry_msgs/msg/Point'  # a type that is installed
START_NS = 5 * 10**9


@pytest.mark.parametrize('rate', [0.5, inf])
def test_the_rate_divides_the_times_between_messages(monkeypatch: pytest.MonkeyPatch, rate: float) -> None:
    now_s, published = [100.0], list[tuple[float, str]]()

    def sleep(seconds: float) -> None:
        now_s[0] += seconds

    def create_publisher(_: object, topic: str, __: object) -> Any:
        return SimpleNamespace(publish=lambda _: published.append((now_s[0] - 100.0, topic)))

    monkeypatch.setattr(player, 'time', SimpleNamespace(monotonic=lambda: now_s[0], sleep=sleep))
    types = POINT, 'nowhere/msg/Unknown', POINT
    topics = [PlayedTopic(f'/topic{i}', msgtype) for i, msgtype in enumerate(types)]
    tested = Player(cast(Any, SimpleNamespace(topics=topics, count=0)), rate)
    tested._create_publishers(SimpleNamespace(create_publisher=create_publisher))
    raw = bytes(typestore().serialize_cdr(typestore().types[POINT](1.0, 2.0, 3.0), POINT))
    due = [(0.0, 2), (0.5, 0), (0.6, 1), (3.0, 2)]  # s and topic
    tested._publish_once(PlaybackMessage(START_NS + round(s * 1e9), raw, topic) for s, topic in due)
    assert [topic for _, topic in published] == ['/topic2', '/topic0', '/topic2']
    assert [s for s, _ in published] == pytest.approx([0.0, 0.5 / rate, 3.0 / rate])
    assert (tested.published_count, tested.published_topics) == (3, ['/topic0', '/topic2'])
    (skipped,) = tested.skipped_topics
    assert skipped.startswith('/topic1: type nowhere/msg/Unknown')


@pytest.mark.parametrize(
    ('msgtype', 'latched', 'depth', 'durability'),
    [
        (KEYPOINTS, [True], 3, 'TRANSIENT_LOCAL'),
        (TRANSFORMS, [True], 1000, 'TRANSIENT_LOCAL'),  # each of their publishers kept one
        (TRANSFORMS, [False, True], 1000, 'TRANSIENT_LOCAL'),  # what their subscribers ask for
        (KEYPOINTS, [False, True], 1000, 'VOLATILE'),
    ],
)
def test_late_subscribers_are_served(msgtype: str, latched: list[bool], depth: int, durability: str) -> None:
    offered: Any = [{**make_topic('/topic', msgtype, latched=kept).qos[0], 'depth': 3} for kept in latched]
    profile = choose_playback_profile(parse_qos(offered), msgtype)
    assert profile.durability.name == durability
    assert profile.depth == depth


@pytest.fixture
def listener(peer: Peer) -> Iterator[Any]:
    import rclpy

    node = rclpy.create_node('listener', context=peer.context)
    yield node
    node.destroy_node()


def test_silence_is_explained_by_other_nodes(peer: Peer, listener: Any, capfd: pytest.CaptureFixture[str]) -> None:
    from std_msgs.msg import String

    def read_warning(expected_type: str = KEYPOINTS) -> str:
        capfd.readouterr()
        monitor = SilenceMonitor(listener, 'keypoints', expected_type)
        for _ in range(2):
            monitor.check(0.0)
        (line,) = capfd.readouterr().err.splitlines()
        return line.partition('no message has arrived on /keypoints for 0 s: ')[2]

    assert read_warning('yolo_msgs/msg/DetectionArray').endswith(f'-p node.input_type:={KEYPOINTS}')
    assert 'its QoS is incompatible' in read_warning()
    peer.node.destroy_publisher(peer.keypoints)
    peer.wait_until(lambda: not listener.get_publishers_info_by_topic('/keypoints'))
    peer.node.create_subscription(load_interface_class(KEYPOINTS), '/other/keypoints', print, 1)
    peer.wait_until(lambda: listener.count_subscribers('/other/keypoints') == 1)
    assert 'no publisher; start the detector' in read_warning(), 'the other topic has none either'
    for topic in ('left', 'right'):
        peer.node.create_publisher(load_interface_class(KEYPOINTS), f'/{topic}/keypoints', 1)
    peer.wait_until(lambda: len(listener.get_publishers_info_by_topic('/right/keypoints')) == 1)
    assert 'remap keypoints to /left/keypoints or /right/keypoints?' in read_warning()
    peer.node.create_publisher(String, 'keypoints', 1)
    peer.wait_until(lambda: listener.get_publishers_info_by_topic('/keypoints'))
    assert read_warning() == f'its publisher sends std_msgs/msg/String, expected {KEYPOINTS}'


# Ids that cannot be part of a topic's name: ROS raises an exception for them.
NO_NAMES = ['7', 'a b', 'a/b', 'a__b', '', '~', 'é', 'b1\n', 'b' * 222]


def test_bodies_are_followed_unless_their_ids_are_no_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.subscriptions.load_interface_class', lambda _: object)
    monkeypatch.setattr('mocap_ros.ros.topics.load_interface_class', lambda _: object)
    topics: list[str] = []

    def subscribe(_: object, topic: str, *__: object, **___: object) -> str:
        topics.append(topic)
        return topic

    node: Any = SimpleNamespace(
        resolve_topic_name=str, create_subscription=subscribe, destroy_subscription=topics.remove
    )
    same_versions: Any = SimpleNamespace(add_input=lambda _: None, read=lambda _, raw: raw)
    limits = with_settings(Config(), {'node.max_text': 1000}).node
    inputs = InputSubscriptions(node, HRI_SKELETON, same_versions, lambda: limits)

    def follow(ids: list[str]) -> None:
        inputs._follow_bodies(encode_plain((Header(1, 'camera'), ids), HRI_IDS))

    for ids in (['b1', *NO_NAMES], ['b1', 'b' * 221], ['b1', 'B_2'], ['B_2', 'B_2'], NO_NAMES):
        follow(ids)
        assert sorted(topics) == sorted({f'/humans/bodies/{i}/skeleton2d' for i in ids if i not in NO_NAMES})
    follow(['b1', 'b2'])
    forgotten: list[str] = []
    inputs._run = cast(Any, SimpleNamespace(queue=SimpleNamespace(forget=forgotten.append)))
    follow(['b1'])
    assert forgotten == ['/humans/bodies/b2/skeleton2d']
    inputs._follow_bodies(b'no message')
    assert topics
    inputs.unsubscribe()
    assert not topics


def describe(publisher: int, number: int) -> dict[str, object]:
    return {'publication_sequence_number': number, 'publisher_gid': {'data': bytes([publisher])}}


@given(arrivals=st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60))
def test_what_is_missing_between_messages_of_a_publisher_is_lost(arrivals: list[tuple[int, bool]]) -> None:
    counter, numbers, lost, counted = LostMessages(), [5, 900, 1], 0, 0
    assert counter.count({'publication_sequence_number': None}) == counter.count({}) == 0
    missing, has_arrived = [0] * 3, [False] * 3
    for publisher, arrives in arrivals:
        numbers[publisher] += 1
        if not arrives:
            missing[publisher] += has_arrived[publisher]  # before the first arrival it is not known
            continue
        counted += counter.count(describe(publisher, numbers[publisher]))
        lost, missing[publisher], has_arrived[publisher] = lost + missing[publisher], 0, True
        assert counted == lost


def test_publishers_that_come_and_go_take_no_memory() -> None:
    counter = LostMessages()
    for publisher in range(5 * MAX_PUBLISHERS):
        assert counter.count(describe(publisher, 7)) == 0
    assert len(counter._last_numbers) <= MAX_PUBLISHERS
