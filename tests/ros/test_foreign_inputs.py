# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of other packages over DDS: YOLO with transforms, and the bodies of ROS4HRI."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.replay import replay
from mocap_ros.skeleton import keypoint_layout
from tests.support import foreign_packages
from tests.support.camera_infos import camera_info
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import read_messages
from tests.support.ros_node import TIMEOUT_S, Peer, StartNode, stack_joints, stop_node, wait_until_discovered

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture(scope='module', autouse=True)
def foreign() -> None:
    foreign_packages.build()


def run_detector(env: dict[str, str], kind: str, frames: list[Any], *options: str) -> str:
    """Publish frames as messages of this kind; return what the detector prints."""
    done = subprocess.run(
        [sys.executable, '-m', 'tests.support.foreign_detector', kind, *options],
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


def test_yolo_detections_with_transforms(
    env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
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
    transforms = json.loads(run_detector(env, 'yolo', frames, 'tf', 'map'))
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


def test_bodies_of_ros4hri_that_come_and_go(
    env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
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
