# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""yolo_msgs/DetectionArray, published by yolo_ros."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import validate_text
from mocap_ros.messages.foreign.shared import validate_person_of_field
from mocap_ros.skeleton import keypoint_layout

COCO17 = keypoint_layout('coco17').joints  # keypoint n of the message (n = 1 to 17) is joint n - 1 of this layout


def read_detection(detection: Any, size: ImageSize, limits: NodeConfig) -> Person2D | None:
    """Read the person of a yolo_msgs/Detection.

    The message holds only the keypoints above the detector's threshold. Missing joints get score 0.

    Args:
        detection: message object.
        size: size of the image.
        limits: the parameters that limit the length of a text.

    Returns:
        The person, or None where the detection has no keypoints.

    Raises:
        InputError: a keypoint or the id is not valid; the error names the field.
    """
    keypoints = detection.keypoints.data
    if not keypoints:
        return None
    points, score = np.full((len(COCO17), 2), np.nan), np.zeros(len(COCO17))
    for i, keypoint in enumerate(keypoints):
        joint = keypoint.id - 1
        if not 0 <= joint < len(COCO17):
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id}, expected 1 to {len(COCO17)}')
        if np.isfinite(points[joint]).any():
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id} twice')
        points[joint] = keypoint.point.x, keypoint.point.y
        score[joint] = keypoint.score
    person_id = validate_text(detection.id, 'id', limits)
    return validate_person_of_field(person_id, COCO17, points, score, size[0], 'keypoints')
