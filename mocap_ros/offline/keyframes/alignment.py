# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Alignment of a motion to the image points (Loy et al. 2004, figure 9, step 1), and offsets of the detector.

    min_o sum_f w_f rho( | P R_f o - d_f |^2 ) + ridge |o|^2      for each joint of the trunk

A detector may have a joint elsewhere than the model does (the pelvis lies 4 to 7 cm above the middle of the hips),
and limbs of fixed lengths cannot reach such points. So the constant offset o (m, body's frame) is estimated from
proposed poses: R_f is the body's rotation, P drops the depth, d_f is the back-projected point less the model's
joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.camera_jacobian import camera_jacobian
from mocap_ros.geometry.rotations import centre_poses, fit_rotation, rotation_from_vector
from mocap_ros.geometry.weak_perspective import subtract_weighted_centroid
from mocap_ros.offline.keyframes.image_points import build_low_pass_matrix, nan_median
from mocap_ros.skeleton import CMU15

# the settings of rotation, scale and robustness were tuned on CMU motion capture
ROBUST_SCALE_M = 0.06  # m; scale of Cauchy's loss in the alignment, so that outliers do not pull a pose
ALIGNMENT_ITERATIONS = 8  # Gauss-Newton iterations; a fixed number, since all frames are solved at once
ROTATION_STD = np.radians(3.0)  # rad, of the prior on the rotation: key poses are in the camera's frame already
POINT_STD_M = 0.03  # m, standard deviation of an image point at the body; weighs the points against the prior
LOG_SCALE_INFORMATION = 1.0  # 1 / std^2 of a weak prior on each step's log scale; keeps the equations solvable
MAX_ALIGNMENT_STEP = 0.5  # rad and log scale; limits a Gauss-Newton step taken far from the solution
SCALE_LOW_PASS_S = 0.6  # s, standard deviation; the scale follows the person's distance, which changes slowly
MIN_ALIGNMENT_JOINTS = 3  # joints seen in a frame, below which its alignment is interpolated
MIN_RELATIVE_DEPTH = 0.2  # share of the body's depth; guards the perspective division against joints at the camera
EPSILON = 1e-9  # guards divisions by a radius (m or px) or a sum of weights of zero
# joints that detectors place differently; elbows, wrists, knees and ankles are anatomical landmarks to both
TRUNK_JOINTS = tuple(CMU15.index(j) for j in ('head', 'neck', 'lshoulder', 'rshoulder', 'pelvis', 'lhip', 'rhip'))
# solutions of the reweighted least squares problem; the number is fixed, without a test of convergence
REWEIGHTING_ITERATIONS = 4
OFFSET_SCALE_M = 0.05  # m, scale of Cauchy's loss, near the size of the offsets
RIDGE = 0.2  # share of the total weight; damps the directions in which the body has not turned to the camera
MIN_DIAGONAL = 1e-9  # guards the normal equations of a joint that no frame shows


@dataclass(frozen=True, eq=False)
class AlignedMotion:
    """A motion with a weak-perspective or perspective camera for each frame."""

    joints: Array  # (F, J, 3) m, virtual camera's axes, relative to an origin near the mean of the joints
    scale: Array  # (F,) px/m, scale of the projection at the origin's depth
    translation: Array  # (F, 2) px, image of the origin

    def relative_depth(self, focal: float) -> Array:
        """Return (F, J) depths divided by the origin's depth; 1 if the focal length (px) is infinite."""
        return np.maximum(1 + self.scale[:, None] * self.joints[..., 2] / focal, MIN_RELATIVE_DEPTH)

    def back_project(self, points: Array, focal: float) -> Array:
        """Return (F, J, 2) m, x and y of image points (F, J, 2) px at the depths of their joints."""
        offset = points * self.relative_depth(focal)[..., None] - self.translation[:, None]
        return np.asarray(offset / self.scale[:, None, None])

    def displacement(self, points: Array, focal: float) -> Array:
        """Return (F, J, 2) m, the back-projected image points minus the joints."""
        return self.back_project(points, focal) - self.joints[..., :2]

    def project(self, focal: float) -> Array:
        """Return (F, J, 2) px, the joints' image x' for a focal length in px."""
        flat = self.scale[:, None, None] * self.joints[..., :2] + self.translation[:, None]
        return np.asarray(flat / self.relative_depth(focal)[..., None])


def align_motion(motion: Array, points: Array, weight: Array, times: Array, focal: float) -> AlignedMotion:
    """Translate, rotate and scale each pose (F, J, 3) m to fit its image points robustly (figure 9, step 1).

    Rotations have a prior of `ROTATION_STD` around none. Scales are low-passed, and with the translation
    interpolated over frames of fewer than three seen joints. Points (F, J, 2) and `focal`, which may be infinite,
    are in px.
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
    target = aligned.back_project(image, focal)
    error = aligned.joints[..., :2] - target
    median = np.nan_to_num(nan_median(np.where(score[..., None] > 0, error, np.nan), axis=1))
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


def estimate_body_rotations(joints: Array, body: Array) -> Array:
    """Return the (F, 3, 3) rotations from the frame of a mean pose `body` (J, 3) to that of poses (F, J, 3)."""
    return fit_rotation(np.broadcast_to(body - body.mean(axis=0), joints.shape), centre_poses(joints))


def estimate_joint_offsets(
    motion: AlignedMotion, points: Array, weight: Array, focal: float, body: Array
) -> Array:
    """Return the detector's mean joint offsets (J, 3) m in the frame of the mean pose `body`; 0 for the limbs."""
    projection = estimate_body_rotations(motion.joints, body)[:, None, :2]
    difference = motion.displacement(points, focal)
    out = np.zeros_like(body)
    for joint in TRUNK_JOINTS:
        offset = np.zeros(3)
        rows, target = projection[:, 0], difference[:, joint]
        for _ in range(REWEIGHTING_ITERATIONS):
            error = target - rows @ offset
            robust_weight = weight[:, joint] / (1 + (error**2).sum(axis=-1) / OFFSET_SCALE_M**2)
            normal = np.einsum('f,fdi,fdj->ij', robust_weight, rows, rows)
            right_side = np.einsum('f,fdi,fd->i', robust_weight, rows, target)
            damping = (RIDGE * robust_weight.sum() + MIN_DIAGONAL) * np.eye(3)
            offset = np.linalg.solve(normal + damping, right_side)
        out[joint] = offset
    return out


def subtract_offsets(offsets: Array, motion: AlignedMotion, points: Array, focal: float, body: Array) -> Array:
    """Move image points (F, J, 2) px from the detector's joints to the model's; as in `estimate_joint_offsets`."""
    in_camera = (estimate_body_rotations(motion.joints, body) @ offsets.T).swapaxes(-1, -2)
    px_per_m = motion.scale[:, None] / motion.relative_depth(focal)
    return np.asarray(points - px_per_m[..., None] * in_camera[..., :2])
