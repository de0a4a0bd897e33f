"""Association of detections with tracked people by position and size in the image.

A person with image centre m_p and size s_p is expected, and a detection with centre m_d and size s_d is found.
Their distance and its gate (the largest distance at which the two may be the same person) are

    d(p, d) = |m_d - m_p| / max(s_d, s_p) + |log(s_d / s_p)|
    gate(p) = BASE_GATE + GATE_GROWTH_PER_S * age_p        age_p: seconds since the person was last seen

The Hungarian method chooses the pairs with the least sum of d(p, d) + GATE_GROWTH_PER_S * age_p.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]

BASE_GATE = 1.0  # person sizes (RMS radius, about 0.5 m of an adult); nobody moves farther between two frames
GATE_GROWTH_PER_S = 2.0  # person sizes/s; an unseen person may walk away and the predicted position gets worse
MIN_SIZE = 1e-9  # in the units of the points; guards the divisions by a size when all joints coincide
FORBIDDEN_COST = 1e3  # person sizes; cost of a pair beyond its gate, far above that of permitted pairs


class Extent(NamedTuple):
    """Position and size of a detection in the image.

    Attributes:
        centre: (2,) mean of the seen joints, in the units of the points.
        size: RMS distance of the seen joints from the centre, in the same units.
    """

    centre: Array
    size: float


class ExpectedExtent(NamedTuple):
    """Position and size at which a tracked person is expected.

    Attributes:
        centre: (2,) predicted mean of the joints, in the units of the points.
        size: RMS distance of the joints from the centre when the person was last seen, in the same units.
        age_s: s since the person was last seen.
    """

    centre: Array
    size: float
    age_s: float


def measure_extent(points: Array, weight: Array) -> Extent:
    """Return the image centre and the size of the seen joints.

    Args:
        points: (J, 2) image points in any unit.
        weight: (J,) confidence scores; 0 for a joint that was not seen.
    """
    seen = points[weight > 0]
    centre = seen.mean(axis=0)
    return Extent(centre, float(np.sqrt(((seen - centre) ** 2).sum(axis=1).mean())) + MIN_SIZE)


def compute_distance(expected: ExpectedExtent, detected: Extent) -> float:
    """Return the distance d(p, d) of a detection from an expected person, in sizes of the larger of the two."""
    offset = np.linalg.norm(detected.centre - expected.centre)
    return float(offset / max(detected.size, expected.size) + abs(np.log(detected.size / expected.size)))


def compute_gate(expected: ExpectedExtent) -> float:
    """Return the largest distance at which a detection may be this person, in person sizes."""
    return BASE_GATE + GATE_GROWTH_PER_S * expected.age_s


def associate(expected: Sequence[ExpectedExtent], detected: Sequence[Extent]) -> list[int | None]:
    """Associate detections with expected people so that the sum of distances is least (Hungarian method).

    No pair is farther apart than the person's gate. The time since a person was last seen adds to the cost, so
    that of two people who are equally near a detection the one who was seen more recently gets it.

    Args:
        expected: where the known people are expected.
        detected: the detections, in the same units.

    Returns:
        The index of the expected person for each detection; None for a detection of nobody known.
    """
    out: list[int | None] = [None] * len(detected)
    if not expected or not detected:
        return out
    distance = np.array([[compute_distance(e, d) for e in expected] for d in detected])
    is_within_gate = distance < [compute_gate(e) for e in expected]
    cost = np.where(is_within_gate, distance + [GATE_GROWTH_PER_S * e.age_s for e in expected], FORBIDDEN_COST)
    for row, column in zip(*linear_sum_assignment(cost), strict=True):
        if is_within_gate[row, column]:
            out[int(row)] = int(column)
    return out
