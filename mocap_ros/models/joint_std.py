# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Standard deviation and covariance of each joint position.

    with a lifter, seen:      std_j = sqrt((f |sigma_j|)^2 + (n noise)^2)
    with a lifter, inferred:  std_j = g |sigma_j|                    sigma_j: the lifter's standard deviations
    without a lifter:         std_j = sqrt((h_j posterior_std_j)^2 + floor^2)
    covariance about the body's origin:  C_j = std_j^2 (I / 6 + u u^T / 2)       u: direction of the line of sight

The lifter's standard deviations say which poses an image leaves uncertain. The image noise, which the solver
estimates, says how well this detector sees this person. The factors were chosen so that two thirds of the true
errors are within the standard deviation and 95 % within two: those with a
lifter on trials of training persons, with clean points and under three models of detectors, all limbs seen or an
arm or a leg hidden; the factors h_j, which are larger for inferred joints than for seen ones, on CMU trials of
subject 35 (walk), UJ, UB and 05, with the subject left out of training.

One camera sees depth worst: of the squared errors in 65 trials of training persons, 0.70 lie along the line of
sight. C_j has 2/3 there, that is, a standard deviation twice as large as in a direction across.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIFTER_FACTOR_SEEN = 0.7  # 1, f: factor on the lifter's standard deviations of seen joints, tuned as described
NOISE_FACTOR_SEEN = 1.1  # 1, n: factor on the image noise for seen joints, tuned likewise
LIFTER_FACTOR_INFERRED = 0.8  # 1, g: as f for inferred joints, of which the image says little
POSTERIOR_FACTOR_SEEN = 3.5  # 1, factor on the solver's posterior of seen joints; tuned as described above
POSTERIOR_FACTOR_INFERRED = 5.6  # 1, the same for inferred joints
POSTERIOR_FLOOR_M = 0.011  # m; the posterior does not know the poses that the base poses cannot represent
VARIANCE_ACROSS = 1 / 6  # of the whole variance, in each direction across the line of sight
VARIANCE_ALONG = 2 / 3  # of the whole variance, along the line of sight


def estimate_joint_std(
    posterior_std: Array,
    inferred: NDArray[np.bool_],
    lifter_std: Array | None = None,
    noise: float | Array = 0.0,
    *,
    size: float | Array = 1.0,
    depth: float | Array = 1.0,
) -> Array:
    """Estimate the standard deviation in m of each joint position (..., J), relative to the body's origin.

    Args:
        posterior_std: (..., J) m, of the solver, for the joints that the lifter did not estimate.
        inferred: (..., J) True for joints that were not seen.
        lifter_std: (..., J, 3) or more joints, standard deviations of the joints' coordinates, NaN for frames that
            the lifter did not lift; None without a lifter.
        noise: m, image noise at the body, as the solver estimated it.
        size: size of the person over that of `posterior_std` and `noise`.
        depth: m, of the unit of `lifter_std`.
    """
    factor = np.where(inferred, POSTERIOR_FACTOR_INFERRED, POSTERIOR_FACTOR_SEEN)
    posterior = np.sqrt((factor * size * posterior_std) ** 2 + POSTERIOR_FLOOR_M**2)
    if lifter_std is None:
        return np.asarray(posterior)
    length = depth * np.sqrt((lifter_std[..., : posterior_std.shape[-1], :] ** 2).sum(axis=-1))
    seen = np.sqrt((LIFTER_FACTOR_SEEN * length) ** 2 + (NOISE_FACTOR_SEEN * size * noise) ** 2)
    lifted = np.where(inferred, LIFTER_FACTOR_INFERRED * length, seen)
    return np.where(np.isfinite(length), lifted, posterior)


def compute_joint_covariance(std: Array, place: Array) -> Array:
    """Return the covariances (..., 3, 3) m^2 of points with standard deviations (...) m about the body's origin.

    The direction of its place (..., 3), in the camera's optical frame, is the line of sight.
    """
    direction = place / np.linalg.norm(place, axis=-1, keepdims=True)
    along = (VARIANCE_ALONG - VARIANCE_ACROSS) * direction[..., None] * direction[..., None, :]
    return np.asarray(std[..., None, None] ** 2 * (VARIANCE_ACROSS * np.eye(3) + along))
