# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The player: nobody listens; everything, in a loop, with clock and QoS."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, encode_skeleton_definition
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.skeleton import CMU15
from tests.support.ros_node import TIMEOUT_S, Peer, keypoints_at, run_cli

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


def test_playing_without_a_subscriber_fails_in_one_line(env: dict[str, str], tmp_path: Path) -> None:
    save_sequence(tmp_path / 'demo.npz', make_recording().sequence())
    done = run_cli(env, 'play', tmp_path / 'demo.npz', '--wait', '0.3')
    assert done.returncode == 1
    assert done.stderr.startswith('mocap-ros: no subscriber to /keypoints appeared within 0.3 s; ')
    assert done.stderr.count('\n') == 1
    assert done.stdout.endswith('demo.npz: waiting for a subscriber to /keypoints, for at most 0.3 s\n')


def test_a_sequence_has_no_topic_to_choose(env: dict[str, str], tmp_path: Path) -> None:
    save_sequence(tmp_path / 'demo.npz', make_recording().sequence())
    done = run_cli(env, 'play', tmp_path / 'demo.npz', '--topic', '/people')
    assert done.returncode == 1
    assert done.stderr == 'mocap-ros: --topic: a sequence file has no topics; --to /people publishes on this one\n'


def test_a_name_that_ros_refuses_is_named_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_sequence(tmp_path / 'demo.npz', make_recording().sequence())
    assert main(['play', str(tmp_path / 'demo.npz'), '--to', 'key points']) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("mocap-ros: --to 'key points': topic name must not contain characters")


def test_all_topics_play_in_a_loop_with_clock_and_recorded_qos(
    env: dict[str, str], peer: Peer, tmp_path: Path
) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    bag, start = tmp_path / 'bag', 5 * 10**9
    best_effort = {**make_topic('/keypoints', KEYPOINTS).qos[0], 'reliability': 'best_effort'}
    definition = encode_skeleton_definition(CMU15)
    with Recorder(bag, RecorderConfig()) as recorder:
        recorder.add_topic(make_topic('/keypoints', KEYPOINTS, qos=[best_effort]))
        recorder.declare_topic('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, definition, start, start)
        for i in range(10):
            recorder.write('/keypoints', KEYPOINTS, keypoints_at(i), start + i * 10**8, start)

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
    options = ['--all', '--loop', '--clock', '--rate', '2']
    command = [sys.executable, '-m', 'mocap_ros.cli.main', 'play', str(bag), *options]
    player = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        peer.wait_until(lambda: len(received) > 25 and len({c.clock.nanosec for c in clocks}) > 10)
        peer.wait_until(lambda: peer.received['skeleton_definition'])
        peer.wait_until(lambda: 'mocap_player' in peer.node.get_node_names())
        offered = peer.node.get_publishers_info_by_topic('/keypoints')
        reliability = {p.qos_profile.reliability for p in offered if p.node_name == 'mocap_player'}
        (latched,) = peer.node.get_publishers_info_by_topic('/skeleton_definition')
        player.send_signal(signal.SIGINT)
        out, err = player.communicate(timeout=TIMEOUT_S)
    finally:
        player.kill()

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
