"""Which detection is whom: by the detector's id, else by position and size in the image (Hungarian method)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]

FARTHEST_MATCH = 1.0
FARTHER_PER_S = 2.0


def extent(points: Array, weight: Array) -> tuple[Array, float]:
    """Image centre and size (RMS radius) of the seen joints, in the units of the points (J, 2)."""
    seen = points[weight > 0]
    centre = seen.mean(axis=0)
    return centre, float(np.sqrt(((seen - centre) ** 2).sum(axis=1).mean())) + 1e-9


def associate(
    expected: Sequence[tuple[Array, float, float]], found: Sequence[tuple[Array, float]]
) -> list[int | None]:
    """For each detection found, the index of the expected person it is, or None.

    Args:
        expected: centre, size and s since the last sight of the people known.
        found: centre and size of the detections, in the same units.
    """
    out: list[int | None] = [None] * len(found)
    if not expected or not found:
        return out
    distance = np.empty((len(found), len(expected)))
    for row, (centre, size) in enumerate(found):
        for column, (there, large, age) in enumerate(expected):
            apart = np.linalg.norm(centre - there) / max(size, large) + abs(np.log(size / large))
            distance[row, column] = apart / (FARTHEST_MATCH + FARTHER_PER_S * age)
    for row, column in zip(*linear_sum_assignment(np.minimum(distance, 10.0)), strict=True):
        if distance[row, column] < 1.0:
            out[int(row)] = int(column)
    return out
