# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples for robots, as programs of their own over DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mocap_ros.messages.cdr import Header, decode, encode
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.ros.message_types import load_interface_class
from tests.support.paths import ROOT
from tests.support.people import make_person_3d
from tests.support.ros_node import TIMEOUT_S, Peer

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


def make_skeletons(ahead_m: float) -> bytes:
    """Return skeletons of a person who stands so far ahead of the robot, on its x axis."""
    message = decode(encode_skeletons(Header(10**9, 'base_link'), [make_person_3d('anna')]), SKELETONS)
    message.camera_frame_id = 'camera'
    (person,) = message.people
    person.tentative, person.unseen_for = False, 0.0
    person.root_covariance = np.zeros(9)
    for point in (person.root, *person.joints):
        point.x, point.y, point.z = ahead_m, 0.0, 1.0
    for velocity in (person.root_velocity, *person.joint_velocity):
        velocity.x, velocity.y, velocity.z = 0.0, 0.0, 0.0
    return encode(message, SKELETONS)


@pytest.mark.parametrize(
    ('name', 'topic', 'kind', 'is_free'),
    [
        ('stop_when_near', 'stop', 'std_msgs/msg/Bool', lambda m: not m.data),
        ('follow_person', 'cmd_vel', 'geometry_msgs/msg/Twist', lambda m: m.linear.x > 0),
        ('people_layer', 'people_points', 'sensor_msgs/msg/PointCloud2', lambda m: m.width > 0),
    ],
)
def test_an_example_acts_on_a_person_far_away_and_is_safe_when_nothing_is_heard_or_it_ends(
    peer: Peer, env: dict[str, str], name: str, topic: str, kind: str, is_free: Callable[[Any], bool]
) -> None:
    received: list[Any] = []
    subscription = peer.node.create_subscription(load_interface_class(kind), topic, received.append, 10)
    peer.subscriptions.append(subscription)
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    example = subprocess.Popen([sys.executable, str(ROOT / 'examples' / f'{name}.py')], env=env)

    def publish_until(ahead_m: float, condition: Callable[[Any], bool]) -> None:
        def is_as_expected() -> bool:
            skeletons.publish(make_skeletons(ahead_m))
            return bool(received) and condition(received[-1])

        peer.wait_until(is_as_expected)

    try:
        peer.wait_until(lambda: peer.node.count_subscribers('skeletons') == 2)  # the peer has one of its own
        publish_until(5.0, is_free)
        if name == 'people_layer':
            cloud = received[-1]
            assert (cloud.header.frame_id, [field.name for field in cloud.fields]) == (
                'base_link',
                ['x', 'y', 'z'],
            )
            points = np.frombuffer(cloud.data.tobytes(), '<f4').reshape(cloud.width, 3)
            assert points[:, :2].mean(axis=0) == pytest.approx([5.0, 0.0], abs=1e-5)
        else:
            publish_until(0.5, lambda message: not is_free(message))
            publish_until(5.0, is_free)
            peer.wait_until(lambda: not is_free(received[-1]))  # nothing is heard any more
            publish_until(5.0, is_free)
        example.send_signal(signal.SIGINT)
        assert example.wait(TIMEOUT_S) == 0
        peer.wait_until(lambda: name == 'people_layer' or not is_free(received[-1]))
    finally:
        example.kill()
        example.wait()
