# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the node reports: diagnostics, and peers with an incompatible QoS."""

from __future__ import annotations

import time
from typing import Any

import pytest

from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.ros.message_types import load_interface_class
from tests.support.ros_node import Peer, StartNode, keypoints_at, stop_node

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


def test_diagnostics_count_accepted_invalid_and_dropped_messages(peer: Peer, start_node: StartNode) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    received: list[Any] = []
    subscription = peer.node.create_subscription(DiagnosticArray, '/diagnostics', received.append, 10)
    peer.subscriptions.append(subscription)
    node = start_node()
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    peer.keypoints.publish(keypoints_at(1))
    peer.keypoints.publish(keypoints_at(1))
    peer.keypoints.publish(keypoints_at(2)[:50])
    peer.wait_until(lambda: received and '1 invalid' in received[-1].status[0].message)
    assert '; /keypoints: not a mocap_ros_msgs/msg/Keypoints2DArray' in received[-1].status[0].message
    values = {v.key: v.value for v in received[-1].status[0].values}
    assert received[-1].status[0].name == '/mocap_node'
    assert [values[key] for key in ('accepted', 'invalid', 'dropped: stamp')] == ['1', '1', '1']
    assert [v.value for array in received for v in array.status[0].values if v.key == 'people'].count('1') == 1
    assert float(values['solve time p99 (ms)']) > 0
    assert values['recorder'] == 'off'
    stop_node(node)


@pytest.mark.filterwarnings('ignore:Deprecated in favor of:DeprecationWarning')  # rclpy's own log calls
def test_peers_with_an_incompatible_qos_are_logged_once(peer: Peer, start_node: StartNode) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    node = start_node()  # subscribes to keypoints as reliable
    peer.wait_for_node()
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for _ in range(2):
        peer.node.create_publisher(load_interface_class(KEYPOINTS), 'keypoints', best_effort)
        peer.subscriptions.append(
            peer.node.create_subscription(load_interface_class(SKELETONS), 'skeletons', print, latched)
        )
        peer.wait_for_log('a weaker RELIABILITY policy')
        peer.wait_for_log('a stricter DURABILITY policy')
    end = time.monotonic() + 1.0  # s, in which further lines would come
    peer.wait_until(lambda: time.monotonic() > end)
    publisher, subscriber = sorted(line.partition('[mocap_node]: ')[2] for line in stop_node(node))
    assert publisher.startswith(
        '/keypoints: a publisher offers a weaker RELIABILITY policy than this node requests'
    )
    assert subscriber.startswith('/skeletons: a subscriber requests a stricter DURABILITY policy than this node')
