"""A detector's keypoints as rays of the camera to the model's joints, the first step of every reconstruction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import map_to_model_joints
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
        are 0 for joints not seen.

    Raises:
        SkeletonError: A name repeats, or the names cover too few of the model's joints.
    """
    with np.errstate(invalid='ignore'):
        is_valid = np.asarray((np.abs(points) < MAX_POINT_PX).all(axis=-1))
    valid_score = np.where(is_valid, np.minimum(score, MAX_SCORE), 0.0)
    valid_points = np.where(is_valid[..., None], points, 0.0)
    joints, weight = map_to_model_joints(valid_points, valid_score, names, min_score, target)
    return np.where(weight[..., None] > 0, intrinsics.pixels_to_rays(joints), 0.0), weight
