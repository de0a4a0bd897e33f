# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A detector's keypoints as rays of the camera to the model's joints, the first step of every reconstruction."""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.skeleton import CMU15, Skeleton


def convert_to_rays(
    points: Array,
    score: Array,
    names: tuple[str, ...],
    intrinsics: Intrinsics,
    min_score: float,
    target: Skeleton = CMU15,
) -> tuple[Array, Array]:
    """Map keypoints to the joints of the model and undo the distortion of the lens.

    Points (..., Js, 2) px and scores (..., Js) are NaN or 0 where not seen, and scores below `min_score` count as
    0. Returns rays (..., Jt, 2), x / z and y / z, and scores (..., Jt) in [0, 1] of the joints of `target`, both 0
    where not seen and for those farther from the optical axis than any camera shows.

    Raises:
        SkeletonError: A name repeats, or the names cover too few of the model's joints.
    """
    joint_map = build_joint_map(names, target)
    rays, weight = engine.convert_to_rays(
        np.ascontiguousarray(points, float).reshape(-1, len(names), 2),
        np.ascontiguousarray(score, float).reshape(-1, len(names)),
        joint_map.weights,
        joint_map.score_factor,
        min_score,
        intrinsics.focal_lengths,
        intrinsics.center_array,
        intrinsics.distortion.parameters,
    )
    leading = score.shape[:-1]
    return rays.reshape(*leading, -1, 2), weight.reshape(*leading, -1)
