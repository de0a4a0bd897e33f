"""Standard deviation of each joint position.

    with a lifter:     std_j = f_j |sigma_j|                             sigma_j: the lifter's standard deviations
    without a lifter:  std_j = sqrt((f_j posterior_std_j)^2 + floor^2)

The factors f_j are larger for inferred joints than for seen ones. They were chosen so that two thirds of the true
errors are within the standard deviation (docs/tracker.md, "Standard deviations"): that of the lifter's seen joints
on eight trials of people whom it was trained on, under three models of detectors; the others on CMU trials of
subject 35 (walk), UJ, UB and 05, with the subject left out of training.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, INPUT_1D, INPUT_2D, INPUT_BOOLS_1D, kernel

Array = NDArray[np.float64]

LIFTER_FACTOR_SEEN = 0.66  # 1, factor on the lifter's standard deviations of seen joints; tuned as described above
LIFTER_FACTOR_INFERRED = 0.75  # 1, the same for inferred joints
POSTERIOR_FACTOR_SEEN = 3.5  # 1, factor on the solver's posterior of seen joints; tuned as described above
POSTERIOR_FACTOR_INFERRED = 5.6  # 1, the same for inferred joints
POSTERIOR_FLOOR_M = 0.011  # m; the posterior does not know the poses that the base poses cannot represent


def estimate_joint_std(
    posterior_std: Array, inferred: NDArray[np.bool_], lifter_std: Array | None = None
) -> Array:
    """Estimate the standard deviation in m of each joint position (J,), relative to the body's origin.

    It rests on the lifter's standard deviations for the joints that the lifter estimated, because the lifter has
    learned which poses an image leaves uncertain. For the others it rests on the solver's posterior.

    Args:
        posterior_std: (J,) m, posterior standard deviation of each joint (`joint_std` of `JointReconstruction`).
        inferred: (J,) True for joints that were not seen.
        lifter_std: (J, 3) m, standard deviations of the joints' coordinates (`LiftedPoses.std`), NaN for frames
            that the lifter did not lift; None without a lifter.
    """
    if lifter_std is None:
        lifter_std = np.full((len(posterior_std), 3), np.nan)
    return _estimate_joint_std(posterior_std, inferred, lifter_std)


@kernel(FLOATS_1D(INPUT_1D, INPUT_BOOLS_1D, INPUT_2D))
def _estimate_joint_std(posterior_std: Array, inferred: NDArray[np.bool_], lifter_std: Array) -> Array:
    """Compute `estimate_joint_std`, with NaN for joints that the lifter did not estimate."""
    out = np.empty(len(posterior_std))
    for j in range(len(out)):
        length = math.sqrt(lifter_std[j, 0] ** 2 + lifter_std[j, 1] ** 2 + lifter_std[j, 2] ** 2)
        if math.isfinite(length):
            out[j] = (LIFTER_FACTOR_INFERRED if inferred[j] else LIFTER_FACTOR_SEEN) * length
        else:
            factor = POSTERIOR_FACTOR_INFERRED if inferred[j] else POSTERIOR_FACTOR_SEEN
            out[j] = math.sqrt((factor * posterior_std[j]) ** 2 + POSTERIOR_FLOOR_M**2)
    return out
