# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""vision_msgs/Detection3DArray: pose with covariance, and the box around each person."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.bridges.seen import FLESH_M, SeenPeople
from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.skeleton import HIPS

# 1; r, such that of training persons who walk the turns of the body are within 90 % in 90 of 100 frames, and of
# those who stand, sit, or are on the floor in more
COMMON_SHARE = 0.7


def convert_detections(people: SeenPeople) -> dict[str, Any]:
    """Return people as detections.

    The pose is that of the point between the hips, with the axes of the body (x forward, z up along the trunk).
    The covariance is of x, y, z and of the rotations about x, y, z.
    """
    header, count = people.header, len(people.ids)
    centres, sizes = people.compute_boxes()
    poses = np.column_stack(
        [people.roots, people.compute_orientations(), _build_covariances(people).reshape(count, 36)]
    )
    boxes = np.column_stack([centres, np.tile(NO_ROTATION, (count, 1)), sizes])
    scores = people.compute_reliability()
    return {
        'header': header,
        'detections': [
            {
                'header': header,
                'results': [{'hypothesis': ('person', score), 'pose': pose}],
                'bbox': box,
                'id': person_id,
            }
            for person_id, score, pose, box in zip(people.ids, scores, poses, boxes, strict=True)
        ],
    }


def _build_covariances(people: SeenPeople) -> Array:
    covariance = np.zeros((len(people.ids), 6, 6))
    covariance[:, :3, :3] = people.root_covariance
    stds = compute_heading_stds(people.joints, people.joint_std)
    covariance[:, 3:, 3:] = (stds**2)[:, None, None] * np.eye(3)
    return covariance


def compute_heading_stds(joints: Array, joint_std: Array) -> Array:
    """Return the standard deviations (N,) in rad of bodies' directions: hips that are off turn the line between.

    Across the line of sight, the line of length b turns by sqrt(4/3 (1 - r)) std / b, as two thirds of the
    variances lie along it (`models/joint_std.py`), and r of them is the same for both hips; elsewhere it turns
    less. Where nothing is known of the joints (N, J, 3) m, it is the deviation of a direction of which nothing is
    known.
    """
    left, right = HIPS
    breadth = np.linalg.norm(joints[:, left] - joints[:, right], axis=1)
    mean_std = (joint_std[:, left] + joint_std[:, right]) / 2
    std = math.sqrt(4 / 3 * (1 - COMMON_SHARE)) * mean_std / np.maximum(breadth, FLESH_M)
    unknown = math.pi / math.sqrt(3)
    return np.where(np.isfinite(std), np.minimum(std, unknown), unknown)
