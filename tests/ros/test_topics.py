# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the node publishes: people for good messages, a log line for bad ones, diagnostics."""

from __future__ import annotations

import re
import signal
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.skeleton import keypoint_layout
from tests.support.ros_node import Peer, StartNode, keypoints_at, stop_node

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

X = np.arange(17, dtype='f4')
# Bad messages, and the reason that the node logs for each.
BAD_MESSAGES = {
    keypoints_at(10, x=np.where(X == 3, np.inf, X)): r'people\[0\]\.x\[3\]: inf',
    keypoints_at(10, score=np.full(17, 150, 'f4')): r'people\[0\]\.score\[0\]: 150',
    keypoints_at(10, score=np.full(17, -1, 'f4')): r'people\[0\]\.score\[0\]: -1',
    keypoints_at(10, y=X[:5]): r'people\[0\]\.x, y, score: unequal lengths 17, 5, 17',
    keypoints_at(10, skeleton='coco99'): r"people\[0\]\.skeleton: unknown .* 'coco99'; known: .*coco17",
    keypoints_at(10, skeleton='body25'): r"people\[0\]\.skeleton: 'body25' has 25 joints, x has 17",
    keypoints_at(10)[:-6]: 'not a mocap_ros_msgs/msg/Keypoints2DArray',
    b'\0\1\0\0rubbish': 'not a mocap_ros_msgs/msg/Keypoints2DArray',
    keypoints_at(27.5): 'stamp 27500000000 ns is older than',
}


def test_each_bad_message_is_logged_once_and_good_ones_are_processed(peer: Peer, start_node: StartNode) -> None:
    node = start_node()
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    sent = []
    for i, bad in enumerate(BAD_MESSAGES):
        sent.append(20 + i)
        peer.keypoints.publish(keypoints_at(20 + i))
        peer.wait_for_frames(len(sent))
        peer.keypoints.publish(bad)
    unseen = keypoints_at(50, x=np.full(17, np.nan, 'f4'))
    nobody = encode_keypoints(Header(51 * 10**9, 'camera'), (640, 480), [])
    for raw in (unseen, nobody, keypoints_at(52)):
        peer.keypoints.publish(raw)
    peer.wait_for_frames(len(sent) + 3)
    lines = [line for line in stop_node(node, signal.SIGINT) if 'no CameraInfo' not in line]

    assert peer.received_stamps('skeletons') == [s * 10**9 for s in (*sent, 50, 51, 52)]
    assert len(lines) == len(BAD_MESSAGES)
    for number, (line, reason) in enumerate(zip(lines, BAD_MESSAGES.values(), strict=True)):
        assert re.search(rf': /keypoints: message {2 * number + 2}: {reason}', line), line


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


def test_a_person_whom_the_detector_breaks_in_two_stays_one(peer: Peer, start_node: StartNode) -> None:
    joints = keypoint_layout('coco17').joints
    recording = make_recording().sequence()
    is_upper = np.array([not j.endswith(('hip', 'knee', 'ankle')) for j in joints])
    broken, named_anew, count = (8, 9, 15), (12, 18), 24

    def detect(frame: int) -> list[Person2D]:
        person = replace(recording.person(frame), id=f'new_{frame}' if frame in named_anew else 'ann')
        if frame not in broken:
            return [person]
        parts = ((f'upper_{frame}', is_upper), ('ann' if frame == 8 else f'lower_{frame}', ~is_upper))
        return [replace(person, id=n, score=np.where(part, person.score, 0.0)) for n, part in parts]

    node = start_node()
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    for frame in range(count):
        header = Header(10**9 + frame * 33_333_333, 'camera')
        peer.keypoints.publish(encode_keypoints(header, recording.image_size, detect(frame)))
        peer.wait_for_frames(frame + 1)
    published = [decode(raw, SKELETONS).people for raw in peer.received['skeletons']]
    flags = [[(p.id, p.tentative, p.predicted) for p in people] for people in published]
    assert flags == [[('ann', frame < 2, False)] for frame in range(count)]
    stop_node(node)
