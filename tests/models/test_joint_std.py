# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Standard deviations of joint positions: the formulas of the module, their sources, and less certain joints."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models import joint_std
from mocap_ros.models.joint_std import estimate_joint_std

POSTERIOR_STD = np.array([0.01, 0.01, 0.05])  # m
INFERRED = np.array([False, True, False])
LIFTER_STD = np.array([[0.02, 0.03, 0.06], [0.02, 0.03, 0.06], [np.nan] * 3])  # m; 0.07 m together


def test_without_a_lifter_the_posterior_is_scaled_and_has_a_floor() -> None:
    seen, inferred, far = estimate_joint_std(POSTERIOR_STD, INFERRED)
    for std, factor, posterior in (
        (seen, joint_std.POSTERIOR_FACTOR_SEEN, 0.01),
        (inferred, joint_std.POSTERIOR_FACTOR_INFERRED, 0.01),
        (far, joint_std.POSTERIOR_FACTOR_SEEN, 0.05),
    ):
        assert std**2 == pytest.approx((factor * posterior) ** 2 + joint_std.POSTERIOR_FLOOR_M**2)
    assert inferred > seen, 'an inferred joint is less certain than a seen one with the same posterior'
    assert estimate_joint_std(np.zeros(3), INFERRED) == pytest.approx(joint_std.POSTERIOR_FLOOR_M)


def test_the_lifter_decides_where_it_lifted_the_frame() -> None:
    seen, inferred, not_lifted = estimate_joint_std(POSTERIOR_STD, INFERRED, LIFTER_STD)
    assert seen == pytest.approx(joint_std.LIFTER_FACTOR_SEEN * 0.07)
    assert inferred == pytest.approx(joint_std.LIFTER_FACTOR_INFERRED * 0.07)
    assert inferred > seen, 'an inferred joint is less certain than a seen one with the same lifter_std'
    assert not_lifted == estimate_joint_std(POSTERIOR_STD, INFERRED)[2]


def test_joints_are_less_certain_where_the_detector_sees_a_person_badly() -> None:
    noise = 0.03
    seen, inferred, not_lifted = estimate_joint_std(POSTERIOR_STD, INFERRED, LIFTER_STD, noise)
    assert seen**2 == pytest.approx(
        (joint_std.LIFTER_FACTOR_SEEN * 0.07) ** 2 + (joint_std.NOISE_FACTOR_SEEN * noise) ** 2
    )
    assert inferred == pytest.approx(joint_std.LIFTER_FACTOR_INFERRED * 0.07), 'the image says nothing of it'
    assert not_lifted == estimate_joint_std(POSTERIOR_STD, INFERRED)[2], 'the posterior knows the noise'
