"""How far a joint may be from where it is said to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SEEN_LIFTED, FILLED_LIFTED = 0.57, 0.75
SEEN, FILLED = (3.5, 0.011), (5.6, 0.011)


def joint_std(spread: Array, inferred: NDArray[np.bool_], lifted: Array | None = None) -> Array:
    """(J,) m, within which two thirds of the joints are, about the body's origin.

    Where a lifter saw the frame it is the length of the lifter's own standard deviations times a factor: they know
    which poses are hard to tell from an image. Without, it is the posterior spread of the solver, which knows
    nothing of what its base poses cannot do, stretched and floored. All factors were chosen on CMU with the
    subject left out (docs/tracker.md).

    Args:
        spread: (J,) m, as in `Reconstruction`.
        inferred: (J,) True where the joint was not seen.
        lifted: (J, 3) m, as in `Lifted.spread`; NaN where nothing was lifted. None: no lifter.
    """
    factor, floor = np.where(inferred[:, None], FILLED, SEEN).T
    plain = np.sqrt((factor * spread) ** 2 + floor**2)
    if lifted is None:
        return np.asarray(plain)
    told = np.where(inferred, FILLED_LIFTED, SEEN_LIFTED) * np.linalg.norm(lifted, axis=-1)
    return np.where(np.isfinite(told), told, plain)
