"""yolo_msgs/DetectionArray (yolo_ros)."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import checked_text
from mocap_ros.messages.foreign.shared import Size, _person
from mocap_ros.skeleton import layout

COCO17 = layout('coco17').joints


def _of_yolo(detection: Any, size: Size, limits: NodeConfig) -> Person2D | None:
    """Only what the detector believes in is there, and says by an id from 1 which joint of COCO it is."""
    found = detection.keypoints.data
    if not found:
        return None
    points, score = np.full((len(COCO17), 2), np.nan), np.zeros(len(COCO17))
    for i, keypoint in enumerate(found):
        joint = keypoint.id - 1
        if not 0 <= joint < len(COCO17):
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id}, expected 1 to {len(COCO17)}')
        if np.isfinite(points[joint]).any():
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id} twice')
        points[joint] = keypoint.point.x, keypoint.point.y
        score[joint] = keypoint.score
    return _person(checked_text(detection.id, 'id', limits), COCO17, points, score, size[0], 'keypoints')
