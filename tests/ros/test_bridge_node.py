# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_bridge` beside `mocap_node`."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mocap_ros.bridges.bridge import POSES
from mocap_ros.bridges.capsules import CAPSULES
from mocap_ros.bridges.ros4hri import DESCRIPTION, JOINT_STATES
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.markers import DELETE, MARKERS
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.ros.message_types import load_interface_class
from tests.support import foreign_packages
from tests.support.launch_file import load_launch_file
from tests.support.people import make_person_3d
from tests.support.ros_node import Peer, Process, StartNode, keypoints_at, stop_node, wait_until_discovered
from tests.support.swinging_body import STANDING

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = [pytest.mark.ros, pytest.mark.slow]
BRIDGE = sys.executable, '-c', 'import sys; from mocap_ros.ros import main; sys.exit(main.bridge_main())'
StartBridge = Callable[[str], Process]


@pytest.fixture
def start_bridge(env: dict[str, str]) -> Iterator[StartBridge]:
    started: list[Process] = []

    def start(consumers: str) -> Process:
        command = [*BRIDGE, '--ros-args', '-p', f'publish:={consumers}']
        started.append(subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return load_launch_file(monkeypatch)


def listen(peer: Peer, topic: str, kind: str, **qos: Any) -> list[bytes]:
    """Subscribe to a topic; return the list of the messages that will arrive."""
    from rclpy.qos import QoSProfile

    received: list[bytes] = []
    subscription = peer.node.create_subscription(
        load_interface_class(kind), topic, received.append, QoSProfile(**{'depth': 100, **qos}), raw=True
    )
    peer.subscriptions.append(subscription)
    return received


def test_started_by_the_launch_file_it_publishes_the_people_of_the_node(
    peer: Peer, start_node: StartNode, start_bridge: StartBridge, launch_file: ModuleType
) -> None:
    context = {**dict.fromkeys(launch_file.ARGUMENTS, ''), 'bridge': 'poses capsules prediction_markers'}
    node, bridge = launch_file.create_nodes(context)
    node_process = start_node(*(f'{name}:={str(value).lower()}' for name, value in node.parameters[1].items()))
    bridge_process = start_bridge(bridge.parameters[0]['publish'].args[0])
    received = {
        topic: listen(peer, topic, kind)
        for topic, kind in (('poses', POSES), ('capsules', CAPSULES), ('prediction_markers', MARKERS))
    }
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    wait_until_discovered(peer.node, peer.executor, 'mocap_bridge')
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    peer.wait_until(lambda: peer.node.count_subscribers('/predictions') == 1)
    for seconds in np.arange(1, 1.4, 0.04):
        peer.keypoints.publish(keypoints_at(float(seconds)))
    peer.wait_until(lambda: all(len(messages) >= 10 for messages in received.values()))
    for raw, skeletons in zip(received['poses'], peer.received['skeletons'], strict=True):
        poses, people = decode(raw, POSES), decode(skeletons, SKELETONS)
        assert poses.header == people.header
        certain = [p.root for p in people.people if not p.tentative]
        assert [pose.position for pose in poses.poses] == certain
    assert len(decode(received['capsules'][9], CAPSULES).people) == 1
    assert {m.ns for m in decode(received['prediction_markers'][9], MARKERS).markers} >= {'0.2 s', '1 s'}
    # nothing has arrived for a while
    peer.wait_until(lambda: not decode(received['poses'][-1], POSES).poses)
    peer.wait_until(
        lambda: {m.action for m in decode(received['prediction_markers'][-1], MARKERS).markers} == {DELETE}
    )
    assert [line for line in stop_node(bridge_process) if 'no message has arrived' not in line] == []
    assert stop_node(node_process) == []


def test_what_cannot_be_published_is_logged_and_the_others_go_on(peer: Peer, start_bridge: StartBridge) -> None:
    poses = listen(peer, 'poses', POSES)
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    bridge = start_bridge("'people, poses'")
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    wait_until_discovered(peer.node, peer.executor, 'mocap_bridge')
    skeletons.publish(b'no message')
    skeletons.publish(encode_skeletons(Header(1, 'camera'), [make_person_3d('anna')]))
    peer.wait_until(lambda: poses)
    missing, invalid = stop_node(bridge)
    assert 'people_msgs/msg/People' in missing
    assert '/skeletons: message 1: ' in invalid


def test_bodies_of_ros4hri_have_topics_of_their_own(
    env: dict[str, str], peer: Peer, start_bridge: StartBridge
) -> None:
    foreign_packages.build(('hri_msgs',))
    env.update(foreign_packages.environment(env))
    from rclpy.qos import DurabilityPolicy

    bridge = start_bridge('bodies')
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    states = listen(peer, '/humans/bodies/p7/joint_states', JOINT_STATES)
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    person = replace(make_person_3d('7'), joints=STANDING)

    def publish_until(people: list[Any], condition: Callable[[], object]) -> None:
        def is_reached() -> object:
            skeletons.publish(encode_skeletons(Header(1, 'camera'), people))
            return condition()

        peer.wait_until(is_reached)

    publish_until([person], lambda: states)
    descriptions = listen(peer, '/humans/bodies/p7/urdf', DESCRIPTION, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publish_until([person], lambda: descriptions)  # kept for late subscribers
    assert 'l_elbow_p7' in decode(descriptions[0], DESCRIPTION).data
    state = decode(states[0], JOINT_STATES)
    assert len(state.name) == len(state.position) == 20
    publish_until([], lambda: not peer.node.count_publishers('/humans/bodies/p7/joint_states'))
    assert stop_node(bridge) == []
