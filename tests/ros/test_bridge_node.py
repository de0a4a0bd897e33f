# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_bridge` beside `mocap_node`, and messages of other packages over DDS: YOLO, and bodies of ROS4HRI."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bridges.bridge import POSES
from mocap_ros.bridges.capsules import CAPSULES
from mocap_ros.bridges.ros4hri import DESCRIPTION, JOINT_STATES
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.markers import DELETE, MARKERS
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.ros.help import BRIDGE_NAME
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.replay import replay
from mocap_ros.skeleton import keypoint_layout
from tests.support import foreign_packages
from tests.support.bodies import STANDING, make_person_3d
from tests.support.camera_messages import camera_info
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import read_messages
from tests.support.ros_node import (
    TIMEOUT_S,
    Peer,
    StartNode,
    StartProgram,
    keypoints_at,
    stack_joints,
    stop_node,
    wait_until_discovered,
)

pytestmark = [pytest.mark.ros, pytest.mark.slow]
BRIDGE = sys.executable, '-c', 'import sys; from mocap_ros.ros import main; sys.exit(main.bridge_main())'


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
    peer: Peer, start_node: StartNode, start: StartProgram, launch_file: ModuleType
) -> None:
    context = {**dict.fromkeys(launch_file.ARGUMENTS, ''), 'bridge': 'poses capsules prediction_markers'}
    node, bridge = launch_file.create_nodes(context)
    assert (bridge.package, bridge.executable, bridge.name) == ('mocap_ros', BRIDGE_NAME, BRIDGE_NAME)
    node_process = start_node(*(f'{name}:={str(value).lower()}' for name, value in node.parameters[1].items()))
    bridge_process = start(*BRIDGE, '--ros-args', '-p', f'publish:={bridge.parameters[0]["publish"].args[0]}')
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
    # On a busy machine, further ones without people may follow.
    for raw, skeletons in zip(received['poses'][:10], peer.received['skeletons'][:10], strict=True):
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


def test_what_cannot_be_published_is_logged_and_the_others_go_on(peer: Peer, start: StartProgram) -> None:
    poses = listen(peer, 'poses', POSES)
    skeletons = peer.node.create_publisher(load_interface_class(SKELETONS), 'skeletons', 10)
    bridge = start(*BRIDGE, '--ros-args', '-p', "publish:='people, poses'")
    peer.wait_until(lambda: peer.node.count_subscribers('/skeletons') == 2)
    wait_until_discovered(peer.node, peer.executor, 'mocap_bridge')
    skeletons.publish(b'no message')
    skeletons.publish(encode_skeletons(Header(1, 'camera'), [make_person_3d('anna')]))
    peer.wait_until(lambda: poses)
    missing, invalid = stop_node(bridge)
    assert 'people_msgs/msg/People' in missing
    assert '/skeletons: message 1: ' in invalid


def test_bodies_of_ros4hri_have_topics_of_their_own(env: dict[str, str], peer: Peer, start: StartProgram) -> None:
    foreign_packages.build(('hri_msgs',))
    env.update(foreign_packages.environment(env))
    from rclpy.qos import DurabilityPolicy

    bridge = start(*BRIDGE, '--ros-args', '-p', 'publish:=bodies')
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
    publish_until([], lambda: not peer.node.count_publishers('/humans/bodies/p7/joint_states'))
    assert stop_node(bridge) == []


@pytest.fixture(scope='module', autouse=True)
def foreign() -> None:
    foreign_packages.build()


def run_detector(env: dict[str, str], kind: str, frames: list[Any]) -> str:
    done = subprocess.run(
        [sys.executable, '-m', 'tests.support.foreign_detector', kind],
        env=foreign_packages.environment(env),
        cwd=ROOT,
        input=json.dumps(frames),
        capture_output=True,
        text=True,
        check=False,
        timeout=3 * TIMEOUT_S,  # the detector itself waits for one event after the other
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def place_people(frame: int, *names: str) -> dict[str, list[list[float]]]:
    """Return the demo person's (x, y, score) in COCO order under each name, side by side."""
    points = make_recording().keypoints[frame].astype(float)
    return {
        name: [[x + 100 * i, y, s] if s > 0 else [0.0, 0.0, 0.0] for x, y, s in points.tolist()]
        for i, name in enumerate(names)
    }


def assert_replay_gives_the_same(bag_folder: Path, out: Path, skeletons: list[bytes]) -> None:
    with Bag(bag_folder) as bag:
        replay(bag, out)
    replayed = read_messages(out, '/skeletons')
    np.testing.assert_allclose(stack_joints(replayed), stack_joints(skeletons), atol=1e-9, rtol=0)


def test_yolo_with_transforms(env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    env.update(foreign_packages.environment(env))
    node = start_node(
        'node.input_type:=yolo_msgs/msg/DetectionArray',
        'node.publish_tf:=true',
        'node.output_frame:=map',
        'node.frame_prefix:=left_',
        'recorder.enabled:=true',
        f'recorder.folder:={tmp_path}/bags',
    )
    peer.wait_for_node()
    info = peer.node.create_publisher(load_interface_class(CAMERA_INFO), 'camera_info', 1)
    peer.wait_until(info.get_subscription_count)
    wait_until_discovered(peer.node, peer.executor, 'mocap_node')
    info.publish(camera_info())
    peer.wait_for_diagnostics('focal length', 'known')
    frames: list[Any] = [[(f + 1) * 10**8, place_people(f, 'anna', 'b/ob')] for f in range(20)]
    transforms = json.loads(run_detector(env, 'yolo', frames))
    peer.wait_for_frames(len(frames))
    assert stop_node(node) == []
    for raw, (stamp_ns, _) in zip(peer.received['skeletons'], frames, strict=True):
        skeletons = decode(raw, SKELETONS)
        assert [p.id for p in skeletons.people] == ['anna', 'b/ob']
        assert (skeletons.header.frame_id, skeletons.camera_frame_id) == ('map', 'camera')
        assert skeletons.camera_pose.position.x == pytest.approx(stamp_ns / 1e9 + 0.5)
    parents_and_children = {tuple(t) for message in transforms for t in message}
    assert ('map', 'left_body_anna') in parents_and_children
    assert ('left_body_b_ob', 'left_l_shoulder_b_ob') in parents_and_children
    assert ('map', 'left_mocap_world') in parents_and_children
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        assert bag.topics['/keypoints'] == 'yolo_msgs/msg/DetectionArray'
        own = [m for m in bag.messages(['/tf']) if is_of_people_only(m.raw, 'left_')]
        assert len(own) == len(frames)  # what the node heard of itself is no input
    assert_replay_gives_the_same(bag_folder, tmp_path / 'again', peer.received['skeletons'])


def test_bodies_that_come_and_go(env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path) -> None:
    env.update(foreign_packages.environment(env))
    node = start_node(
        'node.input_type:=hri_msgs/msg/Skeleton2D',
        'node.image_width:=640',
        'node.image_height:=480',
        'recorder.enabled:=true',
        f'recorder.folder:={tmp_path}/bags',
    )
    peer.wait_for_node()
    ids = [['b1'], ['b1', 'b2'], ['b1', 'b2'], ['b2']]  # of the bodies in each frame
    coco_joints = keypoint_layout('coco17').joints
    order = [coco_joints.index(j) if j != 'neck' else -1 for j in keypoint_layout('hri18').joints]
    frames = []
    for i, present in enumerate(ids):
        people = {
            name: [[p[j][0] / 640, p[j][1] / 480, p[j][2]] if j >= 0 else [0.0, 0.0, 0.0] for j in order]
            for name, p in place_people(i, 'b1', 'b2').items()
            if name in present
        }
        frames.append([(i + 1) * 10**8, people])
    run_detector(env, 'hri', frames)
    peer.wait_for_frames(len(frames))
    assert stop_node(node) == []
    people_seen = [decode(raw, SKELETONS).people for raw in peer.received['skeletons']]
    assert [[p.id for p in people if not p.predicted] for people in people_seen] == ids
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    assert_replay_gives_the_same(bag_folder, tmp_path / 'again', peer.received['skeletons'])
