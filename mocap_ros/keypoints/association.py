"""Association of detections with known people, by where the people are in the image.

The distance of a person p and a detection d has a gate, the largest distance at which the two may be the same
person. The Hungarian method chooses the pairs with the least sum of costs; pairs beyond their gate are no pairs.
With the centre m and the size s of keypoints, and the seconds age_p since the person was last seen, the tracker,
which predicts where it expects each person (`associate`), uses

    distance(p, d) = |m_d - m_p| / max(s_d, s_p) + |log(s_d / s_p)|
    gate(p) = BASE_GATE + GATE_GROWTH_PER_S * age_p
    cost(p, d) = distance(p, d) + GATE_GROWTH_PER_S * age_p

Readers of files have no predictions and compare the keypoints with those of the last detection of the person
(`associate_keypoints`). Crossing people often overlap, and the keypoints tell them apart where the extents do not:

    distance(p, d) = median over joints j of |d_j - p_j| / max(s_d, s_p)
    gate(p) = BASE_GATE + UNPREDICTED_GATE_GROWTH_PER_S * age_p
    cost(p, d) = distance(p, d) / gate(p)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocap_ros.compiled.kernel import BOOLS_2D, FLOAT, FLOATS_2D, INPUT_1D, INPUT_2D, kernel
from mocap_ros.keypoints.person import Person2D

Array = NDArray[np.float64]

BASE_GATE = 1.0  # person sizes (RMS radius, about 0.5 m of an adult); nobody moves farther between two frames
GATE_GROWTH_PER_S = 2.0  # person sizes/s; an unseen person may walk away and the predicted position gets worse
UNPREDICTED_GATE_GROWTH_PER_S = 3.0  # person sizes/s; more than with a prediction, as the person keeps moving
MIN_SIZE_PX = 1.0  # px; guards a division by the size of a person of whom a single keypoint is seen
MIN_SIZE = 1e-9  # in the units of the points; guards the divisions by a size when all joints coincide
# rays, 0.5 px at a focal length of 500 px; a detection that is no larger has all its joints in one place
MIN_DETECTION_SIZE = 1e-3
FORBIDDEN_COST = 1e3  # person sizes; cost of a pair beyond its gate, far above that of permitted pairs


class Extent(NamedTuple):
    """Position and size of a detection in the image.

    Attributes:
        x: x of the mean of the seen joints, in the units of the points.
        y: y of it, in the same units.
        size: RMS distance of the seen joints from it, in the same units.
    """

    x: float
    y: float
    size: float

    @property
    def is_one_place(self) -> bool:
        """Whether all seen joints, whose points are rays, lie in one place, so that they show no person."""
        return not self.size > MIN_DETECTION_SIZE


class ExpectedExtent(NamedTuple):
    """Position and size at which a tracked person is expected.

    Attributes:
        x: x of the predicted mean of the joints, in the units of the points.
        y: y of it, in the same units.
        size: RMS distance of the joints from their mean when the person was last seen, in the same units.
        age_s: s since the person was last seen.
    """

    x: float
    y: float
    size: float
    age_s: float


def measure_extent(points: Array, weight: Array) -> Extent:
    """Return the image centre and the size of the seen joints; NaN if none was seen.

    Args:
        points: (J, 2) image points in any unit.
        weight: (J,) confidence scores; 0 for a joint that was not seen.
    """
    return Extent(*_measure_extent(np.ascontiguousarray(points, float), np.ascontiguousarray(weight, float)))


@kernel(types.UniTuple(FLOAT, 3)(INPUT_2D, INPUT_1D))
def _measure_extent(points: Array, weight: Array) -> tuple[float, float, float]:
    """Compute `measure_extent`."""
    seen, x, y, squares = 0, 0.0, 0.0, 0.0
    for j in range(len(weight)):
        if weight[j] > 0:
            seen, x, y = seen + 1, x + points[j, 0], y + points[j, 1]
    if seen == 0:
        return math.nan, math.nan, math.nan
    x, y = x / seen, y / seen
    for j in range(len(weight)):
        if weight[j] > 0:
            squares += (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2
    return x, y, math.sqrt(squares / seen) + MIN_SIZE


def compute_distance(expected: ExpectedExtent, detected: Extent) -> float:
    """Return the distance d(p, d) of a detection from an expected person, in sizes of the larger of the two."""
    return float(_measure_distance(*expected[:3], *detected))


@kernel(FLOAT(FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT))
def _measure_distance(x: float, y: float, size: float, other_x: float, other_y: float, other_size: float) -> float:
    """Return the distance of two extents."""
    return math.hypot(other_x - x, other_y - y) / max(size, other_size) + abs(math.log(other_size / size))


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
    if not expected or not detected:
        return [None] * len(detected)
    return _choose_pairs(*_compute_costs(np.array(expected), np.array(detected)))


@kernel(types.Tuple((FLOATS_2D, BOOLS_2D))(INPUT_2D, INPUT_2D))
def _compute_costs(expected: Array, detected: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Compute cost(p, d) of all pairs (D, P), and whether their distance is within the gate.

    Args:
        expected: (P, 4) fields of `ExpectedExtent`.
        detected: (D, 3) fields of `Extent`.
    """
    cost = np.full((len(detected), len(expected)), FORBIDDEN_COST)
    is_within_gate = np.zeros(cost.shape, np.bool_)
    for d in range(len(detected)):
        for p in range(len(expected)):
            x, y, size, age_s = expected[p, 0], expected[p, 1], expected[p, 2], expected[p, 3]
            distance = _measure_distance(x, y, size, detected[d, 0], detected[d, 1], detected[d, 2])
            if distance < BASE_GATE + GATE_GROWTH_PER_S * age_s:
                cost[d, p], is_within_gate[d, p] = distance + GATE_GROWTH_PER_S * age_s, True
    return cost, is_within_gate


def associate_keypoints(
    known: Sequence[Person2D], ages_s: Sequence[float], detected: Sequence[Person2D]
) -> list[int | None]:
    """Associate detections with known people by their keypoints so that the sum of costs is least.

    Args:
        known: the last detection of each known person; of every person at least one keypoint is seen.
        ages_s: s since each of these detections.
        detected: the detections, with keypoints in px.

    Returns:
        The index of the known person for each detection; None for a detection of nobody known.
    """
    if not known or not detected:
        return [None] * len(detected)
    gates = [BASE_GATE + UNPREDICTED_GATE_GROWTH_PER_S * age_s for age_s in ages_s]
    cost = np.array([[compute_keypoint_distance(k, d) for k in known] for d in detected]) / gates
    return _choose_pairs(cost, cost < 1)


def compute_keypoint_distance(a: Person2D, b: Person2D) -> float:
    """Return the median distance of the keypoints that are seen in both, or of the centres, in person sizes."""
    extents = [measure_extent(p.points, p.score) for p in (a, b)]
    size = max(*(e.size for e in extents), MIN_SIZE_PX)
    seen_in_both = (a.score > 0) & (b.score > 0) if a.joints == b.joints else np.zeros(0, bool)
    if seen_in_both.any():
        return float(np.median(np.linalg.norm(a.points[seen_in_both] - b.points[seen_in_both], axis=1))) / size
    return math.hypot(extents[0].x - extents[1].x, extents[0].y - extents[1].y) / size


def _choose_pairs(cost: Array, is_permitted: NDArray[np.bool_]) -> list[int | None]:
    """Return the person of each detection, None for none, so that the sum of costs is least (Hungarian method).

    Args:
        cost: (D, P) cost of a pair of a detection and a person.
        is_permitted: (D, P) whether the two may be a pair; the others are left out of the result.
    """
    chosen: list[int | None] = [None] * len(cost)
    for row, column in zip(*linear_sum_assignment(cost), strict=True):
        if is_permitted[row, column]:
            chosen[int(row)] = int(column)
    return chosen
