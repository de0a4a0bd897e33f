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

A pose is the mean of those that the image allows, so its bones have too little depth, and a person who is enlarged
until they have their true lengths is too large and too far away. A bone of the length l is expected to be

    sqrt(l^2 + E max(sigma_p, sigma_c)^2)           sigma: the lifter's along the line of sight at the bone's ends
"""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import motion as engine
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.skeleton import Skeleton

# 1; E, by the distances of 160 training persons of known height, whole and live; 0.5 where all bias is to go
HIDDEN_SHARE = 0.4


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


def compute_joint_covariance(std: Array, position: Array) -> Array:
    """Return the covariances (..., 3, 3) m^2 of standard deviations (...) m along lines of sight (..., 3)."""
    direction = position / np.linalg.norm(position, axis=-1, keepdims=True)
    along = (engine.VARIANCE_ALONG - engine.VARIANCE_ACROSS) * direction[..., None] * direction[..., None, :]
    return np.asarray(std[..., None, None] ** 2 * (engine.VARIANCE_ACROSS * np.eye(3) + along))
