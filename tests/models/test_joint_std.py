# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Standard deviations of joint positions: the formulas of the module, their sources, and less certain joints."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models import joint_std
from mocap_ros.models.joint_std import compute_joint_covariance, estimate_joint_std

POSTERIOR_STD = np.array([0.01, 0.01, 0.05])  # m
INFERRED = np.array([False, True, False])
LIFTER_STD = np.array([[0.02, 0.03, 0.06], [0.02, 0.03, 0.06], [np.nan] * 3])  # m; 0.07 m together


def test_the_lifter_decides_where_it_lifted_and_noise_and_hiding_make_joints_less_certain() -> None:
    posterior = estimate_joint_std(POSTERIOR_STD, INFERRED)
    seen, inferred, not_lifted = estimate_joint_std(POSTERIOR_STD, INFERRED, LIFTER_STD)
    noisy = estimate_joint_std(POSTERIOR_STD, INFERRED, LIFTER_STD, 0.03)
    assert posterior[1] > posterior[0] > joint_std.POSTERIOR_FLOOR_M
    assert inferred > seen
    assert (seen, inferred) == pytest.approx((0.7 * 0.07, 0.8 * 0.07))
    assert not_lifted == posterior[2]
    assert noisy[0] > seen
    assert noisy[1:].tolist() == [inferred, not_lifted], 'the image says nothing of it, and the posterior knows it'
    assert estimate_joint_std(np.zeros(3), INFERRED) == pytest.approx(joint_std.POSTERIOR_FLOOR_M)


def test_covariances_are_longest_along_the_line_of_sight(rng: np.random.Generator) -> None:
    position = rng.normal(size=(4, 3))
    covariance = compute_joint_covariance(np.full(4, 0.3), position)
    values, vectors = np.linalg.eigh(covariance)
    assert values.sum(axis=1) == pytest.approx(np.full(4, 0.09))
    assert np.abs((vectors[..., 2] * position).sum(axis=1)) == pytest.approx(np.linalg.norm(position, axis=1))
