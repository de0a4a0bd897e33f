# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples for robots, as programs of their own over DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def run_example(
    peer: Peer, env: dict[str, str], name: str, topic: str, kind: str
) -> Iterator[tuple[Any, list[Any]]]:
    """Run an example; yield a publisher of skeletons and the list of what the example publishes."""
    received: list[Any] = []
    peer.subscriptions.append(
        peer.node.create_subscription(load_interface_class(kind), topic, received.append, 10)
    )
    publisher = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    example = subprocess.Popen([sys.executable, str(ROOT / 'examples' / f'{name}.py')], env=env)
    try:
        peer.wait_until(lambda: peer.node.count_subscribers('skeletons') == 2)  # the peer has one of its own
        yield publisher, received
        example.send_signal(signal.SIGINT)
        assert example.wait(TIMEOUT_S) == 0
    finally:
        example.kill()
        example.wait()


def publish_until(peer: Peer, publisher: Any, received: list[Any], raw: bytes, condition: Any) -> None:
    received.clear()

    def is_as_expected() -> bool:
        publisher.publish(raw)
        return bool(received) and condition(received[-1])

    peer.wait_until(is_as_expected)


def test_the_robot_stops_unless_everybody_is_far_away(peer: Peer, env: dict[str, str]) -> None:
    with run_example(peer, env, 'stop_when_near', 'stop', 'std_msgs/msg/Bool') as (publisher, received):
        peer.wait_until(lambda: received and received[-1].data)  # nothing is heard
        for ahead_m, must_stop in ((5.0, False), (0.5, True), (5.0, False)):
            publish_until(peer, publisher, received, make_skeletons(ahead_m), lambda m, s=must_stop: m.data == s)
        peer.wait_until(lambda: received[-1].data)  # nothing is heard any more
        publish_until(peer, publisher, received, make_skeletons(5.0), lambda stop: not stop.data)
    peer.wait_until(lambda: received[-1].data)  # the example has ended


def test_the_robot_drives_to_a_person_and_stands_when_nothing_is_heard_or_it_ends(
    peer: Peer, env: dict[str, str]
) -> None:
    with run_example(peer, env, 'follow_person', 'cmd_vel', 'geometry_msgs/msg/Twist') as (publisher, received):
        for _ in range(2):
            publish_until(peer, publisher, received, make_skeletons(5.0), lambda command: command.linear.x > 0)
            peer.wait_until(lambda: received[-1].linear.x == 0)
        publish_until(peer, publisher, received, make_skeletons(5.0), lambda command: command.linear.x > 0)
    peer.wait_until(lambda: received[-1].linear.x == 0)


def test_the_costmap_gets_points_about_a_person(peer: Peer, env: dict[str, str]) -> None:
    kind = 'sensor_msgs/msg/PointCloud2'
    with run_example(peer, env, 'people_layer', 'people_points', kind) as (publisher, received):
        publish_until(peer, publisher, received, make_skeletons(5.0), lambda cloud: cloud.width > 0)
        cloud = received[-1]
        assert (cloud.header.frame_id, [field.name for field in cloud.fields]) == ('base_link', ['x', 'y', 'z'])
        points = np.frombuffer(cloud.data.tobytes(), '<f4').reshape(cloud.width, 3)
        assert points[:, :2].mean(axis=0) == pytest.approx([5.0, 0.0], abs=1e-5)
