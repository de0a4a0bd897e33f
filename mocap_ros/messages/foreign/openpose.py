"""openpose_ros2_msgs/PoseKeyPointsList."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.foreign.shared import Size, _person
from mocap_ros.messages.foreign.yolo import COCO17
from mocap_ros.messages.foreign.zed import COCO18
from mocap_ros.skeleton import layout

BODY25 = layout('body25').joints


OPENPOSE_LAYOUTS = {len(joints): joints for joints in (COCO17, COCO18, BODY25)}


def _of_openpose(body: Any, size: Size, _: NodeConfig) -> Person2D | None:
    found = body.pose_key_points
    if len(found) not in OPENPOSE_LAYOUTS:
        known = ', '.join(map(str, OPENPOSE_LAYOUTS))
        raise InputError(f'pose_key_points: {len(found)} joints, expected {known}')
    points = np.array([[p.x, p.y] for p in found], np.float64)
    score = np.array([p.score for p in found], np.float64)
    return _person('', OPENPOSE_LAYOUTS[len(found)], points, score, size[0], 'pose_key_points')
