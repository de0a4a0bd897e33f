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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

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


def is_in_one_place(rays: Array, weight: Array) -> bool:
    """Return whether all seen joints of a detection lie in one place, so that they show no person.

    Args:
        rays: (J, 2) x / z and y / z of the joints in the camera.
        weight: (J,) confidence scores; 0 for a joint that was not seen. At least one was seen.
    """
    return not measure_extent(rays, weight).size > MIN_DETECTION_SIZE


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
    if not expected or not detected:
        return [None] * len(detected)
    distance = np.array([[compute_distance(e, d) for e in expected] for d in detected])
    is_within_gate = distance < [compute_gate(e) for e in expected]
    cost = np.where(is_within_gate, distance + [GATE_GROWTH_PER_S * e.age_s for e in expected], FORBIDDEN_COST)
    return _choose_pairs(cost, is_within_gate)


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
    return float(np.linalg.norm(extents[0].centre - extents[1].centre)) / size


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
