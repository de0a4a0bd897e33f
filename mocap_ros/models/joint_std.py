"""Standard deviation of each joint position.

    with a lifter:     std_j = f_j |sigma_j|                             sigma_j: the lifter's standard deviations
    without a lifter:  std_j = sqrt((f_j posterior_std_j)^2 + floor^2)

The factors f_j are larger for inferred joints than for seen ones. They were chosen on CMU trials of subject 35
(walk), UJ, UB and 05, with the subject left out of training, so that two thirds of the true errors are within the
standard deviation (docs/tracker.md, "Standard deviations").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIFTER_FACTOR_SEEN = 0.57  # 1, factor on the lifter's standard deviations of seen joints; tuned as described above
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
    factor = np.where(inferred, POSTERIOR_FACTOR_INFERRED, POSTERIOR_FACTOR_SEEN)
    from_posterior = np.sqrt((factor * posterior_std) ** 2 + POSTERIOR_FLOOR_M**2)
    if lifter_std is None:
        return np.asarray(from_posterior)
    factor = np.where(inferred, LIFTER_FACTOR_INFERRED, LIFTER_FACTOR_SEEN)
    from_lifter = factor * np.linalg.norm(lifter_std, axis=-1)
    return np.where(np.isfinite(from_lifter), from_lifter, from_posterior)
