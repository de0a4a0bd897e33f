# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The player over DDS: loop, clock and QoS; and its times without middleware."""

import re
import signal
import sys
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.cdr import typestore
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, encode_skeleton_definition
from mocap_ros.ros import player
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.ros.player import PlaybackOptions, Player
from mocap_ros.runtime.playback import PlaybackMessage, PlayedTopic
from mocap_ros.skeleton import CMU15
from tests.support.ros_node import TIMEOUT_S, Peer, StartProgram, keypoints_at

pytestmark = pytest.mark.ros


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


def test_all_topics_play_in_a_loop_with_clock_and_recorded_qos(
    start: StartProgram, peer: Peer, tmp_path: Path
) -> None:
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
    for msgtype, topic, keep in (
        ('rosgraph_msgs/msg/Clock', '/clock', clocks.append),
        (KEYPOINTS, '/keypoints', received.append),
    ):
        message_class = load_interface_class(msgtype)
        subscription = peer.node.create_subscription(message_class, topic, keep, qos, raw=topic == '/keypoints')
        peer.subscriptions.append(subscription)
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
    tested = Player(cast(Any, SimpleNamespace(topics=topics, count=0)), PlaybackOptions(rate))
    tested._create_publishers(SimpleNamespace(create_publisher=create_publisher))
    raw = bytes(typestore().serialize_cdr(typestore().types[POINT](1.0, 2.0, 3.0), POINT))
    due = [(0.0, 2), (0.5, 0), (0.6, 1), (3.0, 2)]  # s and topic
    tested._publish_once(PlaybackMessage(START_NS + round(s * 1e9), raw, topic) for s, topic in due)
    assert [topic for _, topic in published] == ['/topic2', '/topic0', '/topic2']
    assert [s for s, _ in published] == pytest.approx([0.0, 0.5 / rate, 3.0 / rate])
    assert (tested.published_count, tested.published_topics) == (3, ['/topic0', '/topic2'])
    (skipped,) = tested.skipped_topics
    assert skipped.startswith('/topic1: type nowhere/msg/Unknown')
