# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages for robots are read by the real classes of their packages, built from the published definitions."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.messages.cdr import Header, OutputMessage, decode, typestore
from mocap_ros.messages.foreign.definitions import DETECTIONS_3D, HRI_IDS, OBSTACLES, PEOPLE
from mocap_ros.messages.robots.bodies import DESCRIPTION, JOINT_STATES, BodiesEncoder, BodyNames
from mocap_ros.messages.robots.capsules import CAPSULES, encode_capsules
from mocap_ros.messages.robots.detections import encode_detections
from mocap_ros.messages.robots.obstacles import encode_obstacles
from mocap_ros.messages.robots.people import encode_people
from mocap_ros.messages.robots.poses import POSES, encode_poses
from mocap_ros.people import Person3D
from mocap_ros.ros.message_types import load_interface_class
from tests.support import foreign_packages
from tests.support.paths import ROOT
from tests.support.people import make_person_3d
from tests.support.ros_node import Peer, StartNode, keypoints_at, stop_node
from tests.support.swinging_body import STANDING

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = [pytest.mark.ros, pytest.mark.slow]

READER = ROOT / 'tests' / 'support' / 'real_message_reader.py'


def encode_bodies(header: Header, people: Sequence[Person3D]) -> list[OutputMessage]:
    """Encode people as bodies that were not there before."""
    return BodiesEncoder().encode_update(header, people, BodyNames().assign([p.id for p in people]))


ENCODERS: dict[str, Callable[[Header, Sequence[Person3D]], bytes]] = {
    PEOPLE: encode_people,
    DETECTIONS_3D: encode_detections,
    OBSTACLES: encode_obstacles,
    POSES: encode_poses,
    CAPSULES: encode_capsules,
    HRI_IDS: lambda header, people: encode_bodies(header, people)[0].data,
    JOINT_STATES: lambda header, people: encode_bodies(header, people)[-1].data,
}


def flatten(value: Any) -> Any:
    """Return a message object as nested lists of the values of its fields, numbers as floats."""
    if isinstance(value, list | tuple | np.ndarray):
        return [flatten(v) for v in value]
    if isinstance(value, bool | int | float | np.generic):
        return float(value)
    if isinstance(value, str):
        return value
    _, fields = typestore().fielddefs[value.__msgtype__]
    return [flatten(getattr(value, name)) for name, _ in fields]


def test_the_packages_read_what_was_written(env: dict[str, str]) -> None:
    foreign_packages.build((*foreign_packages.ROBOT_PACKAGES, 'hri_msgs'))
    walker = replace(
        make_person_3d('anna ä'),
        joints=STANDING + [2.0, 1.0, 0.0],
        std=np.full(15, 0.03),
        velocity=np.tile([0.0, 1.0, 0.0], (15, 1)),
        root_covariance=np.diag([0.04, 0.01, 0.02]),
    )
    people = [walker, replace(walker, id='bob', predicted=True, unseen_for=0.4, velocity=np.full((15, 3), np.nan))]
    written = {kind: encode(Header(12_345_678_901, 'map'), people) for kind, encode in ENCODERS.items()}
    done = subprocess.run(
        [sys.executable, str(READER)],
        env=foreign_packages.environment(env),
        input=json.dumps({kind: raw.hex() for kind, raw in written.items()}),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stdout)
    for kind, raw in written.items():
        assert read[kind] == flatten(decode(raw, kind)), kind


@pytest.mark.skipif(importlib.util.find_spec('tf2_msgs') is not None, reason='tf2_msgs is installed')
def test_without_its_types_the_node_runs_and_says_what_is_missing(peer: Peer, start_node: StartNode) -> None:
    node = start_node('node.output_frame:=map', 'node.publish_people:=true', 'node.publish_capsules:=true')
    peer.wait_for_node()
    warnings = [line for line in stop_node(node) if 'not installed' in line]
    missing = {line.partition('type ')[2].split()[0] for line in warnings}
    assert missing == {'tf2_msgs/msg/TFMessage', 'people_msgs/msg/People'}
    assert any('install tf2_msgs, or set node.camera_pose' in line for line in warnings)
    assert any('people is recorded but not published; install people_msgs' in line for line in warnings)


def test_bodies_of_ros4hri_have_topics_of_their_own(
    env: dict[str, str], peer: Peer, start_node: StartNode
) -> None:
    foreign_packages.build(('hri_msgs',))
    env.update(foreign_packages.environment(env))
    node = start_node('node.publish_bodies:=true')
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    from rclpy.qos import DurabilityPolicy, QoSProfile

    states: list[bytes] = []
    descriptions: list[bytes] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for seconds in np.arange(1, 1.3, 0.04):
        peer.keypoints.publish(keypoints_at(float(seconds)))
    peer.wait_until(lambda: len(peer.received['skeletons']) == 8)  # from the third on the person is certain
    for name, kind, keep, qos in (
        ('joint_states', JOINT_STATES, states, 10),
        ('urdf', DESCRIPTION, descriptions, latched),
    ):
        topic = f'/humans/bodies/person_1/{name}'
        peer.node.create_subscription(load_interface_class(kind), topic, keep.append, qos, raw=True)
    peer.wait_until(lambda: descriptions)  # kept for late subscribers
    assert 'l_elbow_person_1' in decode(descriptions[0], DESCRIPTION).data
    stamps = iter(np.arange(1.4, 9, 0.04))

    def is_state_received() -> bool:
        peer.keypoints.publish(keypoints_at(float(next(stamps))))
        return bool(states)

    peer.wait_until(is_state_received)
    state = decode(states[0], JOINT_STATES)
    assert len(state.name) == len(state.position) == 20
    topics = {name for name, _ in peer.node.get_topic_names_and_types()}
    assert {'/humans/bodies/tracked', '/humans/bodies/person_1/joint_states'} <= topics
    assert stop_node(node) == []
