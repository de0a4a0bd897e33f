"""Standard deviations of joints: what they rest on, and what is known less well is said to be."""

import numpy as np

from mocap_ros.models.joint_std import joint_std

SPREAD = np.array([0.01, 0.01, 0.05])
FILLED = np.array([False, True, False])


def test_the_posterior_is_stretched_and_has_a_floor() -> None:
    seen, _, wide = joint_std(SPREAD, FILLED)
    assert 0.02 < seen < wide
    assert (joint_std(np.zeros(3), FILLED) > 0.01).all()


def test_a_lifter_has_the_word_where_it_saw_the_frame() -> None:
    lifted = np.array([[0.02, 0.02, 0.04], [0.02, 0.02, 0.04], [np.nan] * 3])
    std = joint_std(SPREAD, FILLED, lifted)
    assert std[1] > std[0] > 0, 'a filled joint is known less well than a seen one of the same spread'
    np.testing.assert_allclose(joint_std(SPREAD, FILLED, 2 * lifted)[:2], 2 * std[:2])
    np.testing.assert_array_equal(std[2], joint_std(SPREAD, FILLED)[2])
