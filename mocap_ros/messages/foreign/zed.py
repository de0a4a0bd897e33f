"""zed_msgs/ObjectsStamped (ZED wrapper)."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.foreign.shared import Size, _person
from mocap_ros.skeleton import layout

COCO18 = layout('coco18').joints


PERCENT = 100


ZED34 = {
    'lshoulder': 5, 'lelbow': 6, 'lwrist': 7, 'rshoulder': 12, 'relbow': 13, 'rwrist': 14,
    'lhip': 18, 'lknee': 19, 'lankle': 20, 'rhip': 22, 'rknee': 23, 'rankle': 24,
    'nose': 27, 'leye': 28, 'lear': 29, 'reye': 30, 'rear': 31,
}  # fmt: skip


ZED38 = {
    'nose': 5, 'leye': 6, 'reye': 7, 'lear': 8, 'rear': 9, 'lshoulder': 12, 'rshoulder': 13,
    'lelbow': 14, 'relbow': 15, 'lwrist': 16, 'rwrist': 17, 'lhip': 18, 'rhip': 19,
    'lknee': 20, 'rknee': 21, 'lankle': 22, 'rankle': 23,
}  # fmt: skip


ZED_FORMATS = ({joint: i for i, joint in enumerate(COCO18)}, ZED34, ZED38, ZED38)  # of 18, 34, 38, 70 joints


def _of_zed(body: Any, size: Size, _: NodeConfig) -> Person2D | None:
    """Where keypoints have no scores, that of the whole body stands for them. Not seen: NaN, negative or zero."""
    if not body.skeleton_available:
        return None
    if not 0 <= body.body_format < len(ZED_FORMATS):
        raise InputError(f'body_format: {body.body_format}, expected 0 to {len(ZED_FORMATS) - 1}')
    places = ZED_FORMATS[body.body_format]
    points = np.array([body.skeleton_2d.keypoints[i].kp for i in places.values()], np.float64)
    seen = np.isfinite(points).all(axis=1) & (points >= 0).all(axis=1) & (points != 0).any(axis=1)
    if not 0 <= body.confidence <= PERCENT:
        raise InputError(f'confidence: {body.confidence:g}, expected 0 to {PERCENT}')
    score = np.asarray(body.skeleton_keypoint_confidence, np.float64)[list(places.values())] / PERCENT
    if not (score > 0).any():
        score = np.full(len(places), body.confidence / PERCENT)
    points = np.where(np.isinf(points), np.nan, points)
    name = str(body.label_id) if body.tracking_available and body.label_id >= 0 else ''
    return _person(name, tuple(places), points, np.where(seen, score, 0.0), size[0], 'skeleton_2d.keypoints')
