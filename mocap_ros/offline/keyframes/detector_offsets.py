# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Constant offsets between a detector's trunk joints and the model's.

    min_o sum_f w_f rho( | P R_f o - d_f |^2 ) + ridge |o|^2      for each joint of the trunk

o is the offset (m) in the body's frame, R_f the body's rotation, P the orthographic projection to x and y, and d_f
the difference (m) between the back-projected image point and the model's joint. rho is Cauchy's loss.

A detector may place a joint elsewhere than the model does: the pelvis as the middle of the hips, for example, lies
4 to 7 cm below the model's. A motion of fixed limb lengths cannot reach such points, and would bend the rest of
the body instead. The offsets are therefore estimated from proposed 3D poses and subtracted from the image points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.offline.keyframes.gradient_fit import AlignedMotion
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

# joints that detectors place differently; elbows, wrists, knees and ankles are anatomical landmarks to both
TRUNK_JOINTS = tuple(CMU15.index(j) for j in ('head', 'neck', 'lshoulder', 'rshoulder', 'pelvis', 'lhip', 'rhip'))
# solutions of the reweighted least squares problem; the number is fixed, without a test of convergence
REWEIGHTING_ITERATIONS = 4
ROBUST_SCALE_M = 0.05  # m, scale of Cauchy's loss, near the size of the offsets
RIDGE = 0.2  # share of the total weight; damps the directions in which the body has not turned to the camera
MIN_DIAGONAL = 1e-9  # guards the normal equations of a joint that no frame shows


def estimate_body_rotations(joints: Array, body: Array) -> Array:
    """Return the (F, 3, 3) rotations from the frame of a mean pose `body` (J, 3) to that of poses (F, J, 3)."""
    return fit_rotation(np.broadcast_to(body - body.mean(axis=0), joints.shape), centre_poses(joints))


def estimate_joint_offsets(
    motion: AlignedMotion, points: Array, weight: Array, focal: float, body: Array
) -> Array:
    """Estimate the detector's mean joint offsets by reweighted least squares over all frames.

    Args:
        motion: proposed 3D poses, aligned to the image points.
        points: (F, J, 2) px, arbitrary where the weight is 0.
        weight: (F, J) confidence scores, 0 where not seen.
        focal: px, focal length, or infinite.
        body: (J, 3) m, mean pose, whose frame is the body's frame.

    Returns:
        (J, 3) m in the body's frame; 0 for the joints of the limbs.
    """
    projection = estimate_body_rotations(motion.joints, body)[:, None, :2]
    difference = motion.back_project(points, focal) - motion.joints[..., :2]
    out = np.zeros_like(body)
    for joint in TRUNK_JOINTS:
        offset = np.zeros(3)
        rows, target = projection[:, 0], difference[:, joint]
        for _ in range(REWEIGHTING_ITERATIONS):
            error = target - rows @ offset
            robust_weight = weight[:, joint] / (1 + (error**2).sum(axis=-1) / ROBUST_SCALE_M**2)
            normal = np.einsum('f,fdi,fdj->ij', robust_weight, rows, rows)
            right_side = np.einsum('f,fdi,fd->i', robust_weight, rows, target)
            damping = (RIDGE * robust_weight.sum() + MIN_DIAGONAL) * np.eye(3)
            offset = np.linalg.solve(normal + damping, right_side)
        out[joint] = offset
    return out


def subtract_offsets(offsets: Array, motion: AlignedMotion, points: Array, focal: float, body: Array) -> Array:
    """Move image points from the detector's joints to the model's.

    Args:
        offsets: (J, 3) m, from `estimate_joint_offsets`.
        motion: motion aligned to the image points.
        points: (F, J, 2) px.
        focal: px, focal length, or infinite.
        body: (J, 3) m, mean pose, whose frame is the body's frame.

    Returns:
        (F, J, 2) px.
    """
    in_camera = (estimate_body_rotations(motion.joints, body) @ offsets.T).swapaxes(-1, -2)
    px_per_m = motion.scale[:, None] / motion.relative_depth(focal)
    return np.asarray(points - px_per_m[..., None] * in_camera[..., :2])
