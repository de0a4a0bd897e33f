# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The initial smooth motion X^0 between key poses, and its fit to the image points (Loy et al. 2004, section 6).

    slerp(a, b; u) = ( sin((1 - u) omega) a + sin(u omega) b ) / sin(omega)      with cos(omega) = a . b
    X_hat = argmin_X E(X)  subject to X in M_N,      E(X) = || x' - x_hat ||^2                  (eq. 5 and 6)
    X^i = X^{i-1} - lambda grad E(X^{i-1})                                                  (figure 9, step 3)

A control point is a frame of W whose pose is replaced by the key pose of its keyframe; between them each limb
turns at constant speed (Shoemake 1985). x' is the projection of X, and x_hat the weighted image points; E is in
metres at the body. Each step of the descent is followed by step 4, the approximate projection onto the manifold
M_N: limb lengths are reset and trajectories low-passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Indices
from mocap_ros.offline.keyframes.alignment import AlignedMotion
from mocap_ros.offline.keyframes.image_points import build_low_pass_matrix, nan_median
from mocap_ros.skeleton import Skeleton
from mocap_ros.solvers.window import SolverStatus

Bones = Sequence[tuple[int, int]]  # (parent, child) joint indices of each bone

ROBUST_SCALE = 0.1  # torso lengths; a joint this far from its key pose counts less than by its square
EPSILON = 1e-9  # guards divisions by lengths (m), times (s) and counts of zero
MIN_ANGLE = 1e-6  # rad; guards the division by sin(omega) when two directions are the same
MAX_ANGLE = np.pi - 0.05  # rad; guards the division by sin(omega) when two directions are opposite


def compute_limb_directions(poses: Array, bones: Bones) -> Array:
    """Return the (..., B, 3) unit vectors from parent to child joint of poses (..., J, 3)."""
    parents, children = (list(side) for side in zip(*bones, strict=True))
    limbs = poses[..., children, :] - poses[..., parents, :]
    return np.asarray(limbs / np.maximum(np.linalg.norm(limbs, axis=-1, keepdims=True), EPSILON))


def assemble_poses(directions: Array, lengths: Array, skeleton: Skeleton) -> Array:
    """Return centred poses (..., J, 3) of directions (..., B, 3) and lengths (..., B) of the limbs."""
    bone_index = {bone: i for i, bone in enumerate(skeleton.bones)}
    out = np.zeros((*directions.shape[:-2], len(skeleton.joints), 3))
    for bone in skeleton.outward_bones():
        parent, child = bone
        i = bone_index[bone]
        out[..., child, :] = out[..., parent, :] + lengths[..., i, None] * directions[..., i, :]
    return out - out.mean(axis=-2, keepdims=True)


def compute_reprojection_distances(key_poses: Array, points: Array, seen: NDArray[np.bool_]) -> Array:
    """Return the robust distances (N,) by which the fits of frames to their key poses are ranked (section 6.1).

        e = r sqrt( mean_j log(1 + |x'_j - x_j|^2 / r^2) )      with r = `ROBUST_SCALE`

    Key poses x' (N, J, 2) and points x, in torso lengths, are first aligned by the median difference of the seen
    joints.
    """
    difference = np.where(seen[..., None], key_poses - points, np.nan)
    difference = np.nan_to_num(difference - nan_median(difference, axis=1)[:, None])
    loss = np.where(seen, np.log1p((difference**2).sum(axis=-1) / ROBUST_SCALE**2), 0.0)
    return np.asarray(ROBUST_SCALE * np.sqrt(loss.sum(axis=1) / np.maximum(seen.sum(axis=1), EPSILON)))


def select_control_points(assignment: Indices, distance: Array, times: Array, gap: float) -> Indices:
    """Select the control points: the worst fitting frames of each run assigned to one keyframe are omitted.

    A frame is omitted only if its neighbouring control points are at most `gap` s apart, and never the best of a
    run.
    """
    represented = np.flatnonzero(assignment >= 0)
    before = dict(zip(represented[1:].tolist(), represented[:-1].tolist(), strict=True))
    after = dict(zip(represented[:-1].tolist(), represented[1:].tolist(), strict=True))
    is_control = dict.fromkeys(represented.tolist(), True)
    breaks = np.flatnonzero((np.diff(represented) > 1) | (np.diff(assignment[represented]) != 0)) + 1
    for run in np.split(represented, breaks):
        for frame in run[np.argsort(-distance[run], kind='stable')][:-1].tolist():
            a, b = before.get(frame), after.get(frame)
            if a is None or b is None or times[b] - times[a] > gap:
                continue
            is_control[frame] = False
            after[a], before[b] = b, a
    return np.array([frame for frame in represented.tolist() if is_control[frame]], int)


def slerp(directions: Array, control_times: Array, times: Array) -> Array:
    """Interpolate unit vectors (C, B, 3) between control points to (F, B, 3); the ends are held."""
    after = np.clip(np.searchsorted(control_times, times), 0, len(control_times) - 1)
    before = np.maximum(after - 1, 0)
    elapsed, duration = times - control_times[before], control_times[after] - control_times[before]
    share = np.clip(elapsed / np.maximum(duration, EPSILON), 0, 1)
    share = np.where(before == after, 0.0, share)[:, None, None]
    a, b = directions[before], directions[after]
    cosine = np.clip((a * b).sum(axis=-1, keepdims=True), -1, 1)
    angle = np.clip(np.arccos(cosine), MIN_ANGLE, MAX_ANGLE)
    mixed = (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle)
    length = np.linalg.norm(mixed, axis=-1, keepdims=True)
    return np.asarray(np.where(length > EPSILON, mixed / np.maximum(length, EPSILON), a))


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
    """The result of the projected gradient descent."""

    motion: AlignedMotion
    # m^2, sum (w |e|)^2 / sum w of the reprojection errors e and weights w, before each step and at the end. The
    # limb lengths of the motion are reset once more after the last value
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

    Points (F, J, 2) and `focal`, which may be infinite, are in px; `lengths` (B,) m are equal left and right;
    `step` is lambda, `smoothing` s the standard deviation of the low-pass filter, `tolerance` the relative change
    at the end.
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
