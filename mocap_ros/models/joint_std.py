# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Standard deviation and covariance of each joint position, and the depth of bones that they hide.

    with a lifter, seen:      std_j = sqrt((f sigma_jz)^2 / a + (n noise)^2)         a: `VARIANCE_ALONG`
    with a lifter, inferred:  std_j = g |sigma_j|                    sigma_j: the lifter's standard deviations
    without a lifter:         std_j = sqrt((h_j posterior_std_j)^2 + floor^2)
    covariance about the body's origin:  C_j = std_j^2 (I / 6 + u u^T / 2)       u: direction of the line of sight

The factors, in `engine/motion.pyx`, were chosen so that two thirds of the true errors along the line of sight are
within their standard deviation and 95 % within two, in all joints and postures as evenly as can be: with a lifter
on training persons seen by models of detectors, wide enough to hold for a laboratory that the lifter does not
know; h_j on CMU trials of subject 35 (walk), UJ, UB and 05, left out of training. In 160 trials, 0.71 of the
squared errors lie along that line.

What is published is wider or narrower by the person's posture, and by the size, which is known to the share s:

    std_j' = q sqrt(std_j^2 + (s |x_j - c|)^2)        x_j, c: the joint, and the body's middle

The q are those of split conformal prediction: of training persons in a posture, seen by three models of detectors,
90 of 100 errors of seen and of inferred joints are within the ellipsoids that should hold 90. Who sits, bends or
is on the floor is in fewer of the lifter's examples, and without legs nothing shows how far the trunk leans.

A pose is the mean of those that the image allows, so its bones have too little depth, and a person who is enlarged
until they have their true lengths is too large and too far away. A bone of the length l is expected to be

    sqrt(l^2 + E max(sigma_p, sigma_c)^2)           sigma: the lifter's along the line of sight at the bone's ends
"""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array, Mask
from mocap_ros.engine import motion as engine
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.skeleton import CMU15, Skeleton

# 1; E, by the distances of 160 training persons of known height, whole and live; 0.5 where all bias is to go
HIDDEN_SHARE = 0.4
# 1; q of seen and of inferred joints, of those who stand or walk, of others, and of those whose legs are not seen
POSTURE_FACTORS = np.array([[1.0, 0.85], [1.3, 1.1], [1.1, 0.85]])
_UPRIGHT, _OTHER, _WITHOUT_LEGS = range(3)
# Lengths of a leg; hips that are higher over the lower ankle are of 95 of 100 who stand or walk
UPRIGHT_HEIGHT = 0.87
_HIPS, _KNEES, _ANKLES = ([CMU15.index(side + joint) for side in 'lr'] for joint in ('hip', 'knee', 'ankle'))


def expect_stature(lengths: Array, skeleton: Skeleton, lifted: LiftedPoses | None, depth: Array) -> float:
    """Return the mean expected stature in m of a person with bones of the lengths (F, B) m in F frames.

    `lifted` are the lifted poses in the unit of rays, if there are any, and `depth` (F,) m that of the body.
    """
    if lifted is not None:
        along = depth[:, None] * lifted.std[..., 2]
        parents, children = skeleton.bone_ends
        hidden = np.maximum(along[:, parents], along[:, children])
        hidden = np.where(np.isfinite(hidden), hidden, 0.0)  # NaN where not lifted
        lengths = np.sqrt(lengths**2 + HIDDEN_SHARE * hidden**2)
    return float(np.add.reduce(lengths) @ skeleton.stature_per_bone) / len(lengths)


def widen_by_posture(std: Array, joints: Array, is_seen: Mask, upward: Array, size_share: Array) -> Array:
    """Return the published deviations (..., P, J) m of P people, from those of the module's first formulas.

    `joints` (P, J, 3) m are those of `CMU15`, `is_seen` (P, J) whether the image shows them, `upward` (3,) the
    vertical, and `size_share` (P,) the deviation of people's sizes.
    """
    hips, knees, ankles = (joints[:, pair] for pair in (_HIPS, _KNEES, _ANKLES))
    leg = (np.linalg.norm(hips - knees, axis=-1) + np.linalg.norm(knees - ankles, axis=-1)).mean(axis=1)
    height = ((hips.mean(axis=1, keepdims=True) - ankles) @ upward).max(axis=1)
    posture = np.where(height > UPRIGHT_HEIGHT * leg, _UPRIGHT, _OTHER)
    posture[~is_seen[:, _KNEES + _ANKLES].any(axis=1)] = _WITHOUT_LEGS
    seen, inferred = POSTURE_FACTORS[posture].T[..., None]
    reach = np.linalg.norm(joints - joints.mean(axis=1, keepdims=True), axis=-1)
    return np.asarray(np.where(is_seen, seen, inferred) * np.hypot(std, size_share[:, None] * reach))


def compute_joint_covariance(std: Array, position: Array) -> Array:
    """Return the covariances (..., 3, 3) m^2 of standard deviations (...) m along lines of sight (..., 3)."""
    direction = position / np.linalg.norm(position, axis=-1, keepdims=True)
    along = (engine.VARIANCE_ALONG - engine.VARIANCE_ACROSS) * direction[..., None] * direction[..., None, :]
    return np.asarray(std[..., None, None] ** 2 * (engine.VARIANCE_ACROSS * np.eye(3) + along))
