# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The warning that no messages arrive says why, from what other nodes publish."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.ros.message_types import load_interface_class
from tests.support.ros_node import Peer

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


@pytest.fixture
def node(peer: Peer) -> Iterator[Any]:
    import rclpy

    node = rclpy.create_node('listener', context=peer.context)
    yield node
    node.destroy_node()


def read_warning(node: Any, capfd: pytest.CaptureFixture[str], expected_type: str = KEYPOINTS) -> str:
    from mocap_ros.ros.topics import SilenceMonitor

    capfd.readouterr()
    monitor = SilenceMonitor(node, 'keypoints', expected_type)
    for _ in range(2):
        monitor.check(0.0)
    (line,) = capfd.readouterr().err.splitlines()
    return line.partition('no message has arrived on /keypoints for 0 s: ')[2]


def test_a_publisher_of_another_type_is_named(peer: Peer, node: Any, capfd: pytest.CaptureFixture[str]) -> None:
    from std_msgs.msg import String

    assert read_warning(node, capfd, 'yolo_msgs/msg/DetectionArray') == (
        f'its publisher sends {KEYPOINTS}, expected yolo_msgs/msg/DetectionArray; '
        f'start the node with -p node.input_type:={KEYPOINTS}'
    )
    peer.node.destroy_publisher(peer.keypoints)
    peer.node.create_publisher(String, 'keypoints', 1)
    expected = f'its publisher sends std_msgs/msg/String, expected {KEYPOINTS}'
    peer.wait_until(lambda: node.get_publishers_info_by_topic('/keypoints')[0].topic_type == 'std_msgs/msg/String')
    assert read_warning(node, capfd) == expected


def test_without_a_publisher_topics_of_the_type_are_suggested(
    peer: Peer, node: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    assert read_warning(node, capfd).startswith('its publisher sends nothing, or its QoS is incompatible')
    peer.node.destroy_publisher(peer.keypoints)
    peer.wait_until(lambda: not node.get_publishers_info_by_topic('/keypoints'))
    assert read_warning(node, capfd).startswith('it has no publisher; start the detector')
    peer.node.create_subscription(load_interface_class(KEYPOINTS), '/other/keypoints', print, 1)
    peer.wait_until(lambda: node.count_subscribers('/other/keypoints') == 1)
    assert read_warning(node, capfd).startswith('it has no publisher; start the detector'), 'one without publisher'
    for topic in ('left', 'right'):
        peer.node.create_publisher(load_interface_class(KEYPOINTS), f'/{topic}/keypoints', 1)
    peer.wait_until(lambda: len(node.get_publishers_info_by_topic('/right/keypoints')) == 1)
    assert (
        read_warning(node, capfd) == 'it has no publisher; remap keypoints to /left/keypoints or /right/keypoints?'
    )
