# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A detector that publishes YOLO or ROS4HRI messages; run as a module, with the foreign packages on its path.

Its argument is `yolo` or `hri`. With `yolo`, it also says where the camera is in the frame map, by a latched
transform and one that moves, waits for transforms and prints their frames as JSON. Its standard input is JSON: for
each frame its stamp in ns, and for each person the (x, y, score) of each joint.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import TransformStamped
from hri_msgs.msg import IdsList, Skeleton2D
from mocap_ros_msgs.msg import Skeleton3DArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage
from yolo_msgs.msg import Detection, DetectionArray, KeyPoint2D

from tests.support.ros_node import TIMEOUT_S, wait_until_discovered

kind, frames = sys.argv[1], json.loads(sys.stdin.read())
rclpy.init()
node = rclpy.create_node('detector')
executor = SingleThreadedExecutor()
executor.add_node(node)
transforms: list[Any] = []
skeletons: list[bytes] = []


def keep_people(message: Any) -> None:
    """Keep the transforms of people, and not those of the camera that this program publishes itself."""
    if all(t.child_frame_id != 'base' for t in message.transforms):
        transforms.append(message)


node.create_subscription(TFMessage, '/tf', keep_people, 1000)
node.create_subscription(Skeleton3DArray, 'skeletons', skeletons.append, 1000, raw=True)


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline
        executor.spin_once(timeout_sec=0.02)


def with_header(message: Any, stamp_ns: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.header.frame_id = 'camera'
    return message


def make_transform(parent: str, child: str, stamp_ns: int, x: float) -> Any:
    transform = TransformStamped(child_frame_id=child)
    transform.header.stamp.sec, transform.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    transform.header.frame_id = parent
    transform.transform.translation.x = x
    return transform


def publish_camera() -> None:
    """Publish a base that moves along x at 1 m/s, and a camera 0.5 m ahead on it."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    static = node.create_publisher(TFMessage, '/tf_static', latched)
    moving = node.create_publisher(TFMessage, '/tf', 100)
    # One of those of /tf is this node's own.
    wait_until(lambda: static.get_subscription_count() and moving.get_subscription_count() > 1)
    wait_until_discovered(node, executor, 'mocap_node')
    static.publish(TFMessage(transforms=[make_transform('base', 'camera', 0, 0.5)]))
    for stamp_ns in range(0, frames[-1][0] + 10**8, 5 * 10**7):
        moving.publish(TFMessage(transforms=[make_transform('map', 'base', stamp_ns, stamp_ns / 1e9)]))
    wait_until_discovered(node, executor, 'mocap_node')  # which has then taken the transforms


def publish_yolo() -> None:
    publisher = node.create_publisher(DetectionArray, 'keypoints', 100)
    wait_until(publisher.get_subscription_count)
    for number, (stamp_ns, people) in enumerate(frames, 1):
        array = with_header(DetectionArray(), stamp_ns)
        for name, points in people.items():
            detection = Detection(id=name)
            for i, (x, y, score) in enumerate(points):
                if score > 0:
                    keypoint = KeyPoint2D(id=i + 1, score=score)
                    keypoint.point.x, keypoint.point.y = x, y
                    detection.keypoints.data.append(keypoint)
            array.detections.append(detection)
        publisher.publish(array)
        wait_until(lambda: len(skeletons) == number)  # noqa: B023


def publish_hri() -> None:
    tracked = node.create_publisher(IdsList, '/humans/bodies/tracked', 100)
    wait_until(tracked.get_subscription_count)
    wait_until_discovered(node, executor, 'mocap_node')  # all subscriptions of ROS4HRI are best effort
    bodies: dict[str, Any] = {}
    for number, (stamp_ns, people) in enumerate(frames, 1):
        for name in people.keys() - bodies.keys():
            tracked.publish(with_header(IdsList(ids=list(people)), stamp_ns - 1))
            bodies[name] = node.create_publisher(Skeleton2D, f'/humans/bodies/{name}/skeleton2d', 100)
            wait_until(bodies[name].get_subscription_count)
            wait_until_discovered(node, executor, 'mocap_node')
        for name in bodies.keys() - people.keys():
            tracked.publish(with_header(IdsList(ids=list(people)), stamp_ns - 1))
            wait_until(lambda: not bodies[name].get_subscription_count())  # noqa: B023
            node.destroy_publisher(bodies.pop(name))
        for name, points in people.items():
            message = with_header(Skeleton2D(), stamp_ns)
            for joint, (x, y, score) in zip(message.skeleton, points, strict=False):
                joint.x, joint.y, joint.c = x, y, score
            bodies[name].publish(message)
        wait_until(lambda: len(skeletons) == number)  # noqa: B023


wait_until_discovered(node, executor, 'mocap_node')
if kind == 'yolo':
    publish_camera()
    publish_yolo()
else:
    publish_hri()
if kind == 'yolo':
    wait_until(lambda: len(transforms) >= len(frames))
    print(json.dumps([[(t.header.frame_id, t.child_frame_id) for t in m.transforms] for m in transforms]))
node.destroy_node()
rclpy.shutdown()
