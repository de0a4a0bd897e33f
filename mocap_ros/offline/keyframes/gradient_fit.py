# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fit of the initial motion to the image points (Loy et al. 2004, section 6.2, figure 9).

    X_hat = argmin_X E(X)  subject to X in M_N,      E(X) = || x' - x_hat ||^2                  (eq. 5 and 6)
    X^i = X^{i-1} - lambda grad E(X^{i-1})                                                  (figure 9, step 3)

x' is the projection of the motion X, and x_hat the image points, whose squared errors count by their weights. Step
1 translates, rotates and scales the initial motion X^0 to fit the image points (`alignment.py`). Each step of the
gradient descent is followed by step 4, the approximate projection onto the manifold M_N of skeleton motions: limb
lengths are reset and the joints' trajectories are low-passed. E is measured in metres at the body, under the
perspective projection if the focal length is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.alignment import EPSILON, AlignedMotion
from mocap_ros.offline.keyframes.filters import build_low_pass_matrix
from mocap_ros.offline.keyframes.interpolation import assemble_poses, compute_limb_directions
from mocap_ros.skeleton import Skeleton
from mocap_ros.solvers.window import SolverStatus

Array = NDArray[np.float64]


def symmetrise_lengths(lengths: Array, skeleton: Skeleton) -> Array:
    """Return limb lengths (B,) in which left and right limbs have the mean of both."""
    child = [c for _, c in skeleton.bones]
    mirrored_bone = [child.index(skeleton.mirror[c]) for c in child]
    return np.asarray((lengths + lengths[mirrored_bone]) / 2)


def reset_limb_lengths(joints: Array, lengths: Array, skeleton: Skeleton) -> Array:
    """Return poses (F, J, 3) with their limb directions but limb lengths (B,), centred (figure 9, step 4)."""
    return assemble_poses(compute_limb_directions(joints, skeleton.bones), lengths, skeleton)


@dataclass(frozen=True, eq=False)
class FitResult:
    """The result of the projected gradient descent.

    Attributes:
        motion: fitted motion X_hat.
        mean_squared_errors: m^2, sum (w |e|)^2 / sum w of the reprojection errors e and weights w, before each
            step and at the end. The limb lengths of the motion are reset once more after the last value.
        status: why the descent stopped.
    """

    motion: AlignedMotion
    mean_squared_errors: tuple[float, ...]
    status: SolverStatus


def fit_motion(
    start: AlignedMotion,
    points: Array,
    weight: Array,
    times: Array,
    lengths: Array,
    skeleton: Skeleton,
    *,
    focal: float,
    step: float,
    smoothing: float,
    iterations: int,
    tolerance: float = 1e-3,
) -> FitResult:
    """Fit a motion to its image points by projected gradient descent (figure 9, steps 2 to 5).

    Args:
        start: aligned initial motion from step 1.
        points: (F, J, 2) px, arbitrary where the weight is 0.
        weight: (F, J) weights in [0, 1].
        times: (F,) s, increasing.
        lengths: (B,) m, limb lengths, left and right equal.
        skeleton: skeleton of the joints.
        focal: px, focal length, or infinite.
        step: lambda, factor of the gradient of the squared error.
        smoothing: s, standard deviation of the low-pass filter; 0 for none.
        iterations: maximum number of steps.
        tolerance: relative change of the error below which the descent has converged.
    """
    low_pass = build_low_pass_matrix(times, smoothing) if smoothing > 0 else None
    motion = replace(start, joints=reset_limb_lengths(start.joints, lengths, skeleton))
    motion, gradient, error = _evaluate_error(motion, points, weight, focal)
    errors = [error]
    status = SolverStatus.MAX_ITERATIONS
    for _ in range(iterations):
        joints = motion.joints.copy()
        joints[..., :2] -= step * gradient
        joints = reset_limb_lengths(joints, lengths, skeleton)
        if low_pass is not None:
            joints = np.asarray(low_pass @ joints.reshape(len(joints), -1)).reshape(joints.shape)
        motion, gradient, error = _evaluate_error(replace(motion, joints=joints), points, weight, focal)
        errors.append(error)
        if abs(errors[-2] - error) <= tolerance * errors[-2]:
            status = SolverStatus.CONVERGED
            break
    joints = reset_limb_lengths(motion.joints, lengths, skeleton)
    return FitResult(replace(motion, joints=joints), tuple(errors), status)


def _evaluate_error(
    motion: AlignedMotion, points: Array, weight: Array, focal: float
) -> tuple[AlignedMotion, Array, float]:
    """Return the motion with the best translation, its error's gradient (F, J, 2) m, and the mean error, m^2."""
    error = motion.joints[..., :2] - motion.back_project(points, focal)
    total = weight.sum(axis=1)
    mean = (weight[..., None] * error).sum(axis=1) / np.maximum(total, EPSILON)[:, None]
    motion = replace(motion, translation=motion.translation - motion.scale[:, None] * mean)
    error = (error - mean[:, None]) * weight[..., None]
    mean_squared_error = float((error**2).sum() / max(weight.sum(), EPSILON))
    return motion, 2 * error, mean_squared_error
