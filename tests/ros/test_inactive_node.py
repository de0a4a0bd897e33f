# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A node that others configure, activate and shut down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.skeletons import SKELETONS
from tests.support.ros_node import ACTIVATE, CONFIGURE, Peer, StartNode, keypoints_at, stop_node

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

SHUT_DOWN_ACTIVE = 7  # of lifecycle_msgs/Transition


def read_state(peer: Peer) -> str:
    from lifecycle_msgs.srv import GetState

    return str(peer.call_service(GetState, 'mocap_node/get_state').current_state.label)


def reset(peer: Peer) -> Any:
    from std_srvs.srv import Trigger

    return peer.call_service(Trigger, 'mocap_node/reset')


def test_a_node_without_autostart_is_configured_activated_and_shut_down_from_outside(
    peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    node = start_node('node.autostart:=false', f'recorder.folder:={tmp_path}/bags')
    assert read_state(peer) == 'unconfigured'
    peer.change_state(CONFIGURE)
    assert read_state(peer) == 'inactive'
    for answer in (reset(peer), peer.record(True), peer.record(False)):
        assert (answer.success, answer.message) == (False, 'the node is not active')
    assert peer.set_parameter('tracker.min_score', 1.0).successful  # nobody is seen as well as that

    peer.change_state(ACTIVATE)
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    peer.keypoints.publish(keypoints_at(1))
    peer.wait_for_frames(1)
    assert decode(peer.received['skeletons'][0], SKELETONS).people == []

    assert reset(peer).success
    bag_folder = Path(peer.record(True).message)
    peer.keypoints.publish(keypoints_at(2))
    peer.wait_for_frames(2)
    peer.change_state(SHUT_DOWN_ACTIVE)
    assert read_state(peer) == 'finalized'
    with Bag(bag_folder) as bag:
        assert bag.count(['/keypoints']) == bag.count(['/skeletons']) == 1
    assert stop_node(node) == []
