# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether standard deviations and covariances are what true errors are: the shares of errors within ellipsoids.

An error e of covariance C is within that of the share p where e^T C^-1 e <= q(p), the chi-squared quantile of 3
degrees of freedom. The covariance of a joint is that of the root plus that in the body (`models/joint_std.py`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.skeleton import Skeleton
from mocap_ros.verdict.accuracy import match_joints

SHARES = (0.68, 0.95)  # p: as many errors are within one and two standard deviations of one dimension
HIPS = ('lhip', 'rhip')  # between which the root is


def compute_coverage(
    joints: Array, std: Array, root_covariance: Array, skeleton: Skeleton, truth: Array, truth_names: Sequence[str]
) -> dict[str, float]:
    """Return the shares of true errors within the ellipsoids of `SHARES`, as `joints68`, `roots95` and so on.

    Those of roots need both hips in the truth, and all need a known covariance. Joints (F, J, 3) and truth (F, J3,
    3) are in m in the camera's optical frame, `std` (F, J) m, `root_covariance` (F, 3, 3) m^2; NaN where unknown.
    """
    try:
        own, others = match_joints(skeleton.joints, truth_names, limbs_only=False)
    except InputError:
        return {}
    error = joints[:, own] - truth[:, others]
    position = np.broadcast_to(joints.mean(axis=1, keepdims=True), joints.shape)[:, own]
    covariance = root_covariance[:, None] + compute_joint_covariance(std[:, own], position)
    out = _compute_shares('joints', error, covariance)
    names = [skeleton.joints[i] for i in own]
    if set(HIPS) <= set(names):
        hips = error[:, [names.index(hip) for hip in HIPS]].mean(axis=1)
        out |= _compute_shares('roots', hips, root_covariance)
    return out


def _compute_shares(name: str, error: Array, covariance: Array) -> dict[str, float]:
    known = np.isfinite(error).all(axis=-1) & np.isfinite(covariance).all(axis=(-1, -2))
    if not known.any():
        return {}
    e, c = error[known], covariance[known]
    distance = (e * np.linalg.solve(c, e[:, :, None])[:, :, 0]).sum(axis=1)
    return {f'{name}{100 * p:.0f}': float((distance <= chi2.ppf(p, 3)).mean()) for p in SHARES}
