"""Standard deviations of joint positions: their sources, and inferred joints are less certain."""

import numpy as np

from mocap_ros.models.joint_std import estimate_joint_std

POSTERIOR_STD = np.array([0.01, 0.01, 0.05])
INFERRED = np.array([False, True, False])


def test_the_posterior_is_scaled_and_has_a_floor() -> None:
    small, _, large = estimate_joint_std(POSTERIOR_STD, INFERRED)
    assert 0.02 < small < large
    assert (estimate_joint_std(np.zeros(3), INFERRED) > 0.01).all()


def test_the_lifter_decides_where_it_lifted_the_frame() -> None:
    lifter_std = np.array([[0.02, 0.02, 0.04], [0.02, 0.02, 0.04], [np.nan] * 3])
    std = estimate_joint_std(POSTERIOR_STD, INFERRED, lifter_std)
    assert std[1] > std[0] > 0, 'an inferred joint is less certain than a seen one with the same lifter_std'
    np.testing.assert_allclose(estimate_joint_std(POSTERIOR_STD, INFERRED, 2 * lifter_std)[:2], 2 * std[:2])
    np.testing.assert_array_equal(std[2], estimate_joint_std(POSTERIOR_STD, INFERRED)[2])
