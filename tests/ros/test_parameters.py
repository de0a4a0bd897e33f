# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ROS parameters of the node: values out of range, unknown names, changes at run time."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from mocap_ros.config import Config, to_yaml
from tests.support.ros_node import TIMEOUT_S, Peer, StartNode, keypoints_at, stop_node, stop_node_and_read_log

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


def test_a_parameter_out_of_range_ends_the_start_with_one_line(start_node: StartNode) -> None:
    process = start_node('tracker.min_score:=2.0')
    _, log = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 1
    (line,) = log.splitlines()
    assert 'tracker.min_score' in line


def test_a_parameter_file_of_the_package_holds_in_every_namespace(start_node: StartNode, tmp_path: Path) -> None:
    """Its wrong value, which nobody would notice in a file without effect, ends the start."""
    file = tmp_path / 'parameters.yaml'
    text = to_yaml(Config())
    file.write_text(text.replace('body_height: 1.7\n', 'body_height: 9.0\n'))
    assert file.read_text() != text
    process = start_node(ros=['-r', '__ns:=/left', '--params-file', str(file)])
    _, log = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 1
    assert 'tracker.body_height' in log


def test_parameters_are_checked_when_they_are_set(peer: Peer, start_node: StartNode) -> None:
    node = start_node('tracker.min_score:=0', 'tracker.window:=3', 'node.publish_predictions:=true')
    peer.wait_for_node()
    assert peer.get_parameter('tracker.window') == 3
    assert peer.set_parameter('tracker.window', 4).successful
    assert not peer.set_parameter('tracker.window', 'four').successful
    assert peer.set_parameter('tracker.min_score', 0.2).successful
    assert not peer.set_parameter('tracker.min_score', 1.5).successful
    assert 'joint, alternation' in peer.set_parameter('solver.method', 'none').reason
    assert not peer.set_parameter('recorder.folder', '/').successful
    assert 'anna' in peer.set_parameter('tracker.body_heights', 'anna').reason
    assert 'tracker.lag = 0' in peer.set_parameter('tracker.lag', 0.2).reason, 'there are no predictions then'
    assert peer.set_parameter('tracker.body_heights', 'anna=1.65').successful
    stop_node(node)


def test_the_node_logs_its_topics_and_the_parameters_that_it_does_not_have(
    peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    (tmp_path / 'p.yaml').write_text('mocap_node: {ros__parameters: {tracker: {windw: 2.0}, queue: 3}}')
    node = start_node('use_sim_time:=false', 'trackr.model:=walk', ros=['--params-file', f'{tmp_path}/p.yaml'])
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    for second in (1, 2):
        peer.keypoints.publish(keypoints_at(second))
    peer.wait_for_frames(2)
    lines = [line.partition('[mocap_node]: ')[2] for line in stop_node_and_read_log(node, signal.SIGINT)]

    unknown, others = lines[:3], lines[3:]
    assert sorted(unknown) == [
        "unknown parameter 'queue' has no effect; did you mean 'node.queue'?",
        "unknown parameter 'tracker.windw' has no effect; did you mean 'tracker.window'?",
        "unknown parameter 'trackr.model' has no effect; did you mean 'tracker.model'?",
    ]
    published = '/skeletons, /cameras, /markers, /points, /skeleton_definition'
    heard = '/keypoints and /camera_info'
    assert others == [
        f'the node is active: it listens on {heard}, publishes {published}, and uses the model walk',
        '/keypoints: the first message was accepted, and people are being published',
    ]
