# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages for which rclpy itself raises errors, and which anyone can send: the node goes on."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

import pytest

from tests.support.pipeline_inputs import encode_demo_frames, with_stamp
from tests.support.ros_node import Peer, StartNode, stop_node

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

SECOND_NS = 10**9


def request_unknown_type(peer: Peer) -> Callable[[], None]:
    """Return a function that calls set_parameters with a value of a type that rclpy does not know."""
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    client: Any = peer.node.create_client(SetParameters, 'mocap_node/set_parameters')
    peer.wait_until(client.service_is_ready)
    value = ParameterValue(type=200)
    request = SetParameters.Request(parameters=[Parameter(name='tracker.lag', value=value)])
    return lambda: client.call_async(request) and None


def publish_clocks(peer: Peer, second: int, nanosecond: int) -> Callable[[], None]:
    """Let the node take its time from /clock, and return a function that sends a time."""
    from rosgraph_msgs.msg import Clock

    assert peer.set_parameter('use_sim_time', True).successful
    publisher = peer.node.create_publisher(Clock, '/clock', 10)
    clock = Clock()
    clock.clock.sec, clock.clock.nanosec = second, nanosecond
    return lambda: publisher.publish(clock)


def publish_negative_time(peer: Peer) -> Callable[[], None]:
    """Return a function that sends a time that rclpy refuses."""
    return publish_clocks(peer, -5, 0)


@pytest.mark.parametrize('prepare', [request_unknown_type, publish_negative_time])
def test_a_message_for_which_rclpy_raises_an_error_does_not_end_the_node(
    peer: Peer, start_node: StartNode, prepare: Any
) -> None:
    node = start_node()
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    attack = prepare(peer)

    def is_logged() -> bool:
        attack()
        return any('an internal error occurred, and the node continues' in line for line in peer.log)

    peer.wait_until(is_logged)
    frames = encode_demo_frames(3)
    for number, frame in enumerate(frames, 1):
        peer.keypoints.publish(with_stamp(frame, number * SECOND_NS // 30 + SECOND_NS))
        peer.wait_for_frames(number)
    assert peer.get_parameter('tracker.lag') is not None, 'its services answer'
    peer.wait_for_diagnostics('accepted', '3')
    lines = stop_node(node, signal.SIGINT)
    assert node.returncode == 0
    assert len([line for line in lines if 'an internal error' in line]) == 1
