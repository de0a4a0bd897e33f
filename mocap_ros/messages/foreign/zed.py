# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""zed_msgs/ObjectsStamped, published by the ZED wrapper."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.copying import copy_as_float64
from mocap_ros.errors import InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.foreign.shared import validate_person_of_field
from mocap_ros.skeleton import keypoint_layout

MAX_CONFIDENCE = 100  # percent; confidences are divided by it to give scores in [0, 1]

# Index of each joint in `skeleton_2d.keypoints`, for each body format of the ZED SDK.
ZED18 = {joint: i for i, joint in enumerate(keypoint_layout('coco18').joints)}  # BODY_18_PARTS
ZED34 = {  # BODY_34_PARTS
    'lshoulder': 5, 'lelbow': 6, 'lwrist': 7, 'rshoulder': 12, 'relbow': 13, 'rwrist': 14,
    'lhip': 18, 'lknee': 19, 'lankle': 20, 'rhip': 22, 'rknee': 23, 'rankle': 24,
    'nose': 27, 'leye': 28, 'lear': 29, 'reye': 30, 'rear': 31,
}  # fmt: skip
ZED38 = {  # BODY_38_PARTS; the first 38 keypoints of BODY_70_PARTS are the same
    'nose': 5, 'leye': 6, 'reye': 7, 'lear': 8, 'rear': 9, 'lshoulder': 12, 'rshoulder': 13,
    'lelbow': 14, 'relbow': 15, 'lwrist': 16, 'rwrist': 17, 'lhip': 18, 'rhip': 19,
    'lknee': 20, 'rknee': 21, 'lankle': 22, 'rankle': 23,
}  # fmt: skip
BODY_FORMATS = (ZED18, ZED34, ZED38, ZED38)  # by the field `body_format`: 18, 34, 38 and 70 keypoints


def read_object(zed_object: Any, size: ImageSize, _: NodeConfig) -> Person2D | None:
    """Read the person of a zed_msgs/Object.

    A keypoint that is NaN, negative or zero was not seen. If no keypoint has a score, every keypoint gets the
    confidence of the whole body.

    Args:
        zed_object: message object.
        size: size of the image.

    Returns:
        The person, or None where the object has no skeleton.

    Raises:
        InputError: the body format, the confidence or a keypoint is not valid; the error names the field.
    """
    if not zed_object.skeleton_available:
        return None
    if not 0 <= zed_object.body_format < len(BODY_FORMATS):
        raise InputError(f'body_format: {zed_object.body_format}, expected 0 to {len(BODY_FORMATS) - 1}')
    indices = BODY_FORMATS[zed_object.body_format]
    points = copy_as_float64([zed_object.skeleton_2d.keypoints[i].kp for i in indices.values()])
    seen = np.isfinite(points).all(axis=1) & (points >= 0).all(axis=1) & (points != 0).any(axis=1)
    if not 0 <= zed_object.confidence <= MAX_CONFIDENCE:
        raise InputError(f'confidence: {zed_object.confidence:g}, expected 0 to {MAX_CONFIDENCE}')
    confidence = copy_as_float64(zed_object.skeleton_keypoint_confidence)
    score = confidence[list(indices.values())] / MAX_CONFIDENCE
    if not (score > 0).any():
        score = np.full(len(indices), zed_object.confidence / MAX_CONFIDENCE)
    points = np.where(np.isinf(points), np.nan, points)
    is_tracked = zed_object.tracking_available and zed_object.label_id >= 0
    person_id = str(zed_object.label_id) if is_tracked else ''
    return validate_person_of_field(
        person_id, tuple(indices), points, np.where(seen, score, 0.0), size[0], 'skeleton_2d.keypoints'
    )
