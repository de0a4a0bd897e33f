# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""openpose_ros2_msgs/PoseKeyPointsList, published by openpose_ros2."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.foreign.shared import validate_person_of_field
from mocap_ros.skeleton import keypoint_layout

# The joints of each layout that OpenPose publishes, by the number of keypoints, which identifies the layout.
JOINTS_BY_COUNT = {
    len(joints): joints for joints in (keypoint_layout(name).joints for name in ('coco17', 'coco18', 'body25'))
}


def read_pose(pose: Any, size: ImageSize, _: NodeConfig) -> Person2D | None:
    """Read the person of an openpose_ros2_msgs/PoseKeyPoints; the message has no ids.

    Args:
        pose: message object.
        size: size of the image.

    Raises:
        InputError: no layout has that number of keypoints, or a keypoint is not valid; the error names the field.
    """
    keypoints = pose.pose_key_points
    if len(keypoints) not in JOINTS_BY_COUNT:
        expected = ', '.join(map(str, JOINTS_BY_COUNT))
        raise InputError(f'pose_key_points: {len(keypoints)} joints, expected {expected}')
    points = np.array([[p.x, p.y] for p in keypoints], np.float64)
    score = np.array([p.score for p in keypoints], np.float64)
    return validate_person_of_field('', JOINTS_BY_COUNT[len(keypoints)], points, score, size[0], 'pose_key_points')
