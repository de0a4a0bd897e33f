# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Association of detections with known people, by where the people are in the image.

The Hungarian method chooses the pairs of the least sum of costs; pairs beyond their gate are no pairs. With the
points p_j and d_j of the joints that are expected and detected, their RMS radii r_p and r_d about their centres,
and s the larger of the sizes s_p and s_d of person and detection, `measure_distances` returns

    distance(p, d) = median over j of |d_j - p_j| / s + |growth|
    growth = log((r_d + 0.1 s) / (r_p + 0.1 s))

or the same with left and right exchanged, if that is less; where fewer than four joints are both expected and
detected, centres m and sizes are compared:

    distance(p, d) = |m_d - m_p| / s + |growth|,    growth = log(s_d / s_p)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from mocap_ros.arrays import Array, Mask
from mocap_ros.engine import association as engine
from mocap_ros.skeleton import CMU15

VELOCITY_SPAN_S = 0.25  # s; velocities are averaged over this time, which evens out image noise and single steps
MIN_VELOCITY_SPAN_S = 0.05  # s; over a shorter time image noise, divided by the time, looks like a fast movement
MIN_SHARED_JOINTS = 4  # joints; a median of fewer is that of one limb, which may be anywhere
RADIUS_OFFSET = 0.1  # person sizes; the radius of a few joints that lie close together is mostly image noise
MIN_SIZE = 1e-9  # in the units of the points; guards the divisions by a size when all joints coincide
# rays, 0.5 px at a focal length of 500 px; a detection that is no larger has all its joints at one position
MIN_DETECTION_SIZE = 1e-3


MIRROR = np.array(CMU15.mirror)  # (J,) indices of the joints with left and right exchanged


class KnownPerson(Protocol):
    """What matching needs of a person who is known; the attributes are those of `tracking.track.Track`."""

    id: str
    given_id: str
    has_newest_id: bool
    is_tentative: bool
    stamps_ns: tuple[int, ...]
    rays: Array
    weight: Array


class SeenPeople(NamedTuple):
    """Where the joints of N people are: points (N, J, 2), and weights (N, J), positive where a joint was seen."""

    points: Array
    weight: Array


def measure_sizes(points: Array, weight: Array) -> Array:
    """Return the RMS distances (N,) of seen joints from their mean, of points (N, J, 2) with weights (N, J).

    They are in the units of the points, and NaN where no joint was seen.
    """
    return engine.measure_sizes(np.ascontiguousarray(points, float), np.ascontiguousarray(weight, float), MIN_SIZE)


def show_people(sizes: Array) -> Mask:
    """Return which detections of sizes (N,) in rays do not have all their seen joints at one position."""
    return np.asarray(sizes > MIN_DETECTION_SIZE)


def expect_people(people: Sequence[KnownPerson], stamp_ns: int) -> SeenPeople:
    """Return where the joints of people are expected at a stamp in ns, from their last `VELOCITY_SPAN_S`.

    Each joint is where it was last seen, moved on with the mean velocity of the joints that the first and the last
    of these frames show, for at most `VELOCITY_SPAN_S`.
    """
    limits = VELOCITY_SPAN_S, MIN_VELOCITY_SPAN_S, MIN_SHARED_JOINTS
    return SeenPeople(*engine.expect_people(people, stamp_ns, len(MIRROR), *limits))


def measure_distances(expected: SeenPeople, detected: SeenPeople, min_shared: int = 0) -> tuple[Array, Array]:
    """Measure the distances (D, P) of D detections from P people in sizes of the larger, and their growths (D, P).

    With fewer than `min_shared` joints both expected and detected the distance is infinite.
    """
    limits = min_shared, MIN_SIZE, MIN_SHARED_JOINTS, RADIUS_OFFSET
    return engine.measure_distances(*expected, *detected, MIRROR, *limits)


def choose_pairs(cost: Array, is_permitted: Mask) -> list[int | None]:
    """Return the person of each detection at the least sum of costs (D, P); None where not permitted."""
    chosen = engine.choose_pairs(cost).tolist()
    return [p if p >= 0 and is_permitted[d, p] else None for d, p in enumerate(chosen)]
