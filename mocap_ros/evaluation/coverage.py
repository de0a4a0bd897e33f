# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether standard deviations and covariances are what true errors are: the shares of errors within ellipsoids.

An error e with the covariance C is within the ellipsoid that holds the share p of normal errors where

    e^T C^-1 e <= q(p),    q = quantile of the chi-squared distribution with 3 degrees of freedom

The covariance of a joint is the sum of that of the root and that of the joint in the body (`models/joint_std.py`).
Shares below p say that the covariances are too small, shares above that they are too large.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mocap_ros.errors import InputError
from mocap_ros.evaluation import metrics
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]

SHARES = (0.68, 0.95)  # p: as many errors are within one and two standard deviations of one dimension
HIPS = ('lhip', 'rhip')  # between which the root is


def compute_coverage(
    joints: Array,
    std: Array,
    root_covariance: Array,
    skeleton: Skeleton,
    truth: Array,
    truth_names: Sequence[str],
) -> dict[str, float]:
    """Return the shares of the true errors within the ellipsoids of `SHARES` (formula of the module).

    Args:
        joints: (F, J, 3) m, camera optical frame; NaN in frames without a prediction.
        std: (F, J) m, standard deviation of each joint in the body; NaN where unknown.
        root_covariance: (F, 3, 3) m^2; NaN where unknown.
        skeleton: skeleton of the joints.
        truth: (F, J3, 3) m, camera optical frame; NaN where unknown.
        truth_names: (J3,) joint names of the truth.

    Returns:
        `joints68`, `joints95`, `roots68` and `roots95`; those of roots only if the truth has both hips, and none
        if no covariance is known.
    """
    try:
        own, others = metrics.match_joints(skeleton.joints, truth_names, limbs_only=False)
    except InputError:
        return {}
    error = joints[:, own] - truth[:, others]
    place = np.broadcast_to(joints.mean(axis=1, keepdims=True), joints.shape)[:, own]
    covariance = root_covariance[:, None] + compute_joint_covariance(std[:, own], place)
    out = _compute_shares('joints', error, covariance)
    names = [skeleton.joints[i] for i in own]
    if set(HIPS) <= set(names):
        hips = error[:, [names.index(hip) for hip in HIPS]].mean(axis=1)
        out |= _compute_shares('roots', hips, root_covariance)
    return out


def _compute_shares(name: str, error: Array, covariance: Array) -> dict[str, float]:
    """Return the shares of errors (..., 3) within the ellipsoids of covariances (..., 3, 3), under their names."""
    known = np.isfinite(error).all(axis=-1) & np.isfinite(covariance).all(axis=(-1, -2))
    if not known.any():
        return {}
    e, c = error[known], covariance[known]
    distance = (e * np.linalg.solve(c, e[:, :, None])[:, :, 0]).sum(axis=1)
    return {f'{name}{100 * p:.0f}': float((distance <= chi2.ppf(p, 3)).mean()) for p in SHARES}
