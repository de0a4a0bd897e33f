"""How far a joint may be from where it is said to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SEEN, FILLED = (1.35, 0.024), (1.85, 0.018)


def joint_std(spread: Array, filled: NDArray[np.bool_]) -> Array:
    """(J,) m, within which two thirds of the joints are, about the body's origin.

    The posterior spread of the solver knows nothing of what its base poses cannot do; the factors and floors that
    make up for it were chosen on CMU with the subject left out (benchmarks/tracker.py).

    Args:
        spread: (J,) m, as in `Reconstruction`.
        filled: (J,) True where the joint was not seen.
    """
    factor, floor = np.where(filled[:, None], FILLED, SEEN).T
    return np.sqrt((factor * spread) ** 2 + floor**2)
