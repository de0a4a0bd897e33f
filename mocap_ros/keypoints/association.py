"""Which detection is whom: by the detector's id, else by position and size in the image (Hungarian method)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]

FARTHEST_MATCH = 1.0
FARTHER_PER_S = 2.0
FAR = 1e3


def extent(points: Array, weight: Array) -> tuple[Array, float]:
    """Image centre and size (RMS radius) of the seen joints, in the units of the points (J, 2)."""
    seen = points[weight > 0]
    centre = seen.mean(axis=0)
    return centre, float(np.sqrt(((seen - centre) ** 2).sum(axis=1).mean())) + 1e-9


Expected = tuple[Array, float, float]


def distance(expected: Expected, found: tuple[Array, float]) -> float:
    """Between a person expected (centre, size and s since the last sight) and found, in sizes of the larger."""
    (there, large, _), (centre, size) = expected, found
    return float(np.linalg.norm(centre - there) / max(size, large) + abs(np.log(size / large)))


def tolerance(expected: Expected) -> float:
    """The farthest that this person may be found from where they are expected."""
    return FARTHEST_MATCH + FARTHER_PER_S * expected[2]


def associate(expected: Sequence[Expected], found: Sequence[tuple[Array, float]]) -> list[int | None]:
    """For each detection found, the index of the expected person it is, or None.

    The sum of distances is the least, and nobody is found beyond their `tolerance`. Somebody not seen for a while
    counts as farther, so that a detection goes to whom it was in the last frame.

    Args:
        expected: centre, size and s since the last sight of the people known.
        found: centre and size of the detections, in the same units.
    """
    out: list[int | None] = [None] * len(found)
    if not expected or not found:
        return out
    apart = np.array([[distance(e, f) for e in expected] for f in found])
    near = apart < [tolerance(e) for e in expected]
    cost = np.where(near, apart + [FARTHER_PER_S * age for _, _, age in expected], FAR)
    for row, column in zip(*linear_sum_assignment(cost), strict=True):
        if near[row, column]:
            out[int(row)] = int(column)
    return out
