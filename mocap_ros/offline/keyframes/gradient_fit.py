# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fit of the initial motion to the image points (Loy et al. 2004, section 6.2, figure 9).

    X_hat = argmin_X E(X)  subject to X in M_N,      E(X) = || x' - x_hat ||^2                  (eq. 5 and 6)
    X^i = X^{i-1} - lambda grad E(X^{i-1})                                                  (figure 9, step 3)

x' is the projection of the motion X, and x_hat the image points, whose squared errors count by their weights. Step
1 translates, rotates and scales the initial motion X^0 to fit the image points (`align_motion`). Each step of the
gradient descent is followed by step 4, the approximate projection onto the manifold M_N of skeleton motions: limb
lengths are reset and the joints' trajectories are low-passed. E is measured in metres at the body, under the
perspective projection if the focal length is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.camera_jacobian import camera_jacobian
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import subtract_weighted_centroid
from mocap_ros.offline.keyframes.filters import build_low_pass_matrix, nan_median
from mocap_ros.offline.keyframes.interpolation import assemble_poses, compute_limb_directions
from mocap_ros.skeleton import Skeleton
from mocap_ros.solvers.window import SolverStatus

Array = NDArray[np.float64]

# the settings of rotation, scale and robustness were tuned on CMU motion capture (docs/keyframes.md)
ROBUST_SCALE_M = 0.06  # m; scale of Cauchy's loss in the alignment, so that outliers do not pull a pose
ALIGNMENT_ITERATIONS = 8  # Gauss-Newton iterations; a fixed number, since all frames are solved at once
ROTATION_STD = np.radians(
    3.0
)  # rad, prior on the alignment's rotation: key poses are in the camera's frame already
POINT_STD_M = 0.03  # m, standard deviation of an image point at the body; weighs the points against the prior
LOG_SCALE_INFORMATION = 1.0  # 1 / std^2 of a weak prior on each step's log scale; keeps the equations solvable
MAX_ALIGNMENT_STEP = 0.5  # rad and log scale; limits a Gauss-Newton step taken far from the solution
SCALE_LOW_PASS_S = 0.6  # s, standard deviation; the scale follows the person's distance, which changes slowly
MIN_ALIGNMENT_JOINTS = 3  # joints seen in a frame, below which its alignment is interpolated
MIN_RELATIVE_DEPTH = 0.2  # share of the body's depth; guards the perspective division against joints at the camera
EPSILON = 1e-9  # guards divisions by a radius (m or px) or a sum of weights of zero


@dataclass(frozen=True, eq=False)
class AlignedMotion:
    """A motion with a weak-perspective or perspective camera for each frame.

    Attributes:
        joints: (F, J, 3) m, virtual camera's axes, relative to an origin near the mean of the joints.
        scale: (F,) px/m, scale of the projection at the origin's depth.
        translation: (F, 2) px, image of the origin.
    """

    joints: Array
    scale: Array
    translation: Array

    def relative_depth(self, focal: float) -> Array:
        """Return (F, J) depths divided by the origin's depth; 1 if the focal length (px) is infinite."""
        return np.maximum(1 + self.scale[:, None] * self.joints[..., 2] / focal, MIN_RELATIVE_DEPTH)

    def back_project(self, points: Array, focal: float) -> Array:
        """Return (F, J, 2) m, x and y of image points (F, J, 2) px at the depths of their joints."""
        offset = points * self.relative_depth(focal)[..., None] - self.translation[:, None]
        return np.asarray(offset / self.scale[:, None, None])

    def project(self, focal: float) -> Array:
        """Return (F, J, 2) px, the joints' image x' for a focal length in px."""
        flat = self.scale[:, None, None] * self.joints[..., :2] + self.translation[:, None]
        return np.asarray(flat / self.relative_depth(focal)[..., None])


def align_motion(motion: Array, points: Array, weight: Array, times: Array, focal: float) -> AlignedMotion:
    """Translate, rotate and scale each pose to fit its image points robustly (figure 9, step 1).

    Rotations have a prior of `ROTATION_STD` around none. Scales are low-passed. Scale and translation are
    interpolated over the frames with fewer than three seen joints, whose poses are not rotated.

    Args:
        motion: (F, J, 3) m, virtual camera's axes.
        points: (F, J, 2) px, arbitrary where the weight is 0.
        weight: (F, J) confidence scores, 0 where not seen.
        times: (F,) s, increasing.
        focal: px, focal length, or infinite.

    Raises:
        InputError: No frame has three seen joints.
    """
    joints = motion - motion.mean(axis=1, keepdims=True)
    frames = np.flatnonzero((weight > 0).sum(axis=1) >= MIN_ALIGNMENT_JOINTS)
    if not len(frames):
        raise InputError('no frame has three joints that are not outliers')
    body, image, score = joints[frames], points[frames], weight[frames]
    a, _ = subtract_weighted_centroid(body[..., :2], score)
    b, _ = subtract_weighted_centroid(image, score)
    radius = [np.sqrt((score[..., None] * v**2).sum(axis=(1, 2))) for v in (a, b)]
    log_scale = np.log(np.maximum(radius[1], EPSILON) / np.maximum(radius[0], EPSILON))
    aligned = AlignedMotion(body, np.exp(log_scale), np.zeros((len(frames), 2)))
    for _ in range(ALIGNMENT_ITERATIONS):
        aligned = _take_alignment_step(aligned, image, score, focal)
    low_pass = build_low_pass_matrix(times[frames], SCALE_LOW_PASS_S)
    scale = np.exp(low_pass @ np.log(aligned.scale))
    all_joints = np.empty_like(joints)
    all_joints[:] = joints
    all_joints[frames] = aligned.joints
    knots = times[frames]
    translation = np.stack([np.interp(times, knots, aligned.translation[:, d]) for d in (0, 1)], axis=-1)
    return AlignedMotion(all_joints, np.exp(np.interp(times, knots, np.log(scale))), translation)


def _take_alignment_step(aligned: AlignedMotion, image: Array, score: Array, focal: float) -> AlignedMotion:
    """Return the alignment after one reweighted Gauss-Newton step of each frame."""
    target = aligned.back_project(image, focal)
    error = aligned.joints[..., :2] - target
    median = _compute_median_error(error, score)
    error = error - median[:, None]
    robust_weight = score / (1 + (error**2).sum(axis=-1) / ROBUST_SCALE_M**2)
    error, mean = subtract_weighted_centroid(error, robust_weight)
    centred, _ = subtract_weighted_centroid(aligned.joints, robust_weight)
    jacobian = camera_jacobian(centred, rows=2)
    information = robust_weight[..., None, None] / POINT_STD_M**2
    normal = (np.swapaxes(jacobian, -1, -2) @ (information * jacobian)).sum(axis=1)
    gradient = (np.swapaxes(jacobian, -1, -2) @ (information * error[..., None])).sum(axis=1)[..., 0]
    normal += np.diag([*[ROTATION_STD**-2] * 3, LOG_SCALE_INFORMATION])
    step = -np.linalg.solve(normal, gradient[..., None])[..., 0]
    step = np.clip(step, -MAX_ALIGNMENT_STEP, MAX_ALIGNMENT_STEP)
    rotated = aligned.joints @ np.swapaxes(rotation_from_vector(step[:, :3]), -1, -2)
    shift = aligned.scale[:, None] * (median + mean)
    return AlignedMotion(rotated, aligned.scale * np.exp(step[:, 3]), aligned.translation - shift)


def _compute_median_error(error: Array, weight: Array) -> Array:
    """Return (F, 2) the median error of the seen joints."""
    return np.nan_to_num(nan_median(np.where(weight[..., None] > 0, error, np.nan), axis=1))


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
    progress: Callable[[], None] = lambda: None,
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
        progress: called after every step.
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
        progress()
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
