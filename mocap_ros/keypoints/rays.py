# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A detector's keypoints as rays of the camera to the model's joints, the first step of every reconstruction."""

from __future__ import annotations

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, kernel
from mocap_ros.geometry.distortion import MAX_RAY, undistort_point
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import build_joint_map, map_joints
from mocap_ros.skeleton import CMU15, Skeleton

Array = NDArray[np.float64]

MAX_POINT_PX = 1e7  # px; far outside any image; keeps arithmetic finite for callers that validate nothing
MAX_SCORE = 1.0  # 1; a higher confidence score counts as this, for scores are probabilities


def convert_to_rays(
    points: Array,
    score: Array,
    names: tuple[str, ...],
    intrinsics: Intrinsics,
    min_score: float,
    target: Skeleton = CMU15,
) -> tuple[Array, Array]:
    """Map keypoints to the joints of the model and undo the distortion of the lens.

    Args:
        points: (..., Js, 2) px; NaN for keypoints that were not seen.
        score: (..., Js) confidence scores; 0 or NaN for keypoints that were not seen.
        names: (Js,) joint names, in any spelling.
        intrinsics: intrinsics of the camera.
        min_score: least confidence score of a keypoint that counts as seen.
        target: skeleton with the joints of the model.

    Returns:
        (..., Jt, 2) rays, each as x / z and y / z, and (..., Jt) scores in [0, 1] of the joints of `target`; both
        are 0 for joints not seen, and for those farther from the optical axis than any camera shows (`MAX_RAY`).

    Raises:
        SkeletonError: A name repeats, or the names cover too few of the model's joints.
    """
    joint_map = build_joint_map(names, target)
    rays, weight = _convert_frames(
        np.ascontiguousarray(points, float).reshape(-1, len(names), 2),
        np.ascontiguousarray(score, float).reshape(-1, len(names)),
        joint_map.weights,
        joint_map.score_factor,
        min_score,
        intrinsics.focal_lengths,
        intrinsics.center_array,
        intrinsics.distortion.parameters,
    )
    lead = score.shape[:-1]
    return rays.reshape(*lead, -1, 2), weight.reshape(*lead, -1)


@kernel(
    types.Tuple((FLOATS_3D, FLOATS_2D))(
        INPUT_3D, INPUT_2D, INPUT_3D, INPUT_2D, FLOAT, INPUT_1D, INPUT_1D, INPUT_1D
    )
)
def _convert_frames(
    points: Array,
    score: Array,
    map_weights: Array,
    score_factor: Array,
    min_score: float,
    focal_lengths: Array,
    center: Array,
    lens: Array,
) -> tuple[Array, Array]:
    used_score = np.zeros_like(score)
    for n in range(score.shape[0]):
        for s in range(score.shape[1]):
            is_valid = abs(points[n, s, 0]) < MAX_POINT_PX and abs(points[n, s, 1]) < MAX_POINT_PX
            if is_valid and score[n, s] >= min_score:
                used_score[n, s] = min(score[n, s], MAX_SCORE)
    joints, weight = map_joints(points, used_score, map_weights, score_factor)
    for n in range(weight.shape[0]):
        for t in range(weight.shape[1]):
            if weight[n, t] > 0:
                x = (joints[n, t, 0] - center[0]) / focal_lengths[0]
                y = (joints[n, t, 1] - center[1]) / focal_lengths[1]
                joints[n, t, 0], joints[n, t, 1] = undistort_point(x, y, lens)
            # farther from the optical axis no camera of this kind shows anything, and a mean of rays means nothing
            is_shown = abs(joints[n, t, 0]) <= MAX_RAY and abs(joints[n, t, 1]) <= MAX_RAY
            if not (weight[n, t] > 0 and is_shown):
                joints[n, t], weight[n, t] = 0.0, 0.0
    return joints, weight
