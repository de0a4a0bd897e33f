# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the association of detections with expected people."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from mocap_ros.keypoints.association import (
    MIN_DETECTION_SIZE,
    MIN_SHARED_JOINTS,
    RADIUS_OFFSET,
    VELOCITY_SPAN_S,
    Array,
    ExpectedPerson,
    choose_pairs,
    expect_person,
    measure_distances,
    measure_sizes,
    show_people,
)
from mocap_ros.skeleton import CMU15

MIRROR = np.array(CMU15.mirror)
JOINTS = len(MIRROR)


def test_joints_that_coincide_show_no_person() -> None:
    rays, weight = np.full((4, 5, 2), 0.3), np.ones((4, 5))
    weight[1] = 0  # nothing is seen
    rays[2:, 0] += 10 * MIN_DETECTION_SIZE
    weight[3, 0] = 0
    assert show_people(measure_sizes(rays, weight)).tolist() == [False, False, True, False]


def make_body(rng: np.random.Generator, x: float = 0.0, size: float = 0.1) -> Array:
    """Return the points (J, 2) of a body whose RMS radius is about `size`."""
    return rng.normal(0, size / math.sqrt(2), (JOINTS, 2)) + [x, 0]


def compute_slowly(person: ExpectedPerson, points: Array, weight: Array) -> tuple[float, float]:
    """Return distance and growth of a pair by the formula."""

    def radius(those: Array) -> float:
        return float(np.sqrt(((those - those.mean(axis=0)) ** 2).sum(axis=1).mean()))

    known, seen = person.weight > 0, weight > 0
    sizes = radius(person.points[known]), radius(points[seen])
    candidates = []
    for labels in (np.arange(JOINTS), MIRROR):
        shared = known & seen[labels]
        a, b = person.points[shared], points[labels][shared]
        if shared.sum() < MIN_SHARED_JOINTS:
            growth = math.log(sizes[1] / sizes[0])
            offset = float(np.linalg.norm(points[seen].mean(axis=0) - person.points[known].mean(axis=0)))
        else:
            extra = RADIUS_OFFSET * max(sizes)
            growth = math.log((radius(b) + extra) / (radius(a) + extra))
            offset = float(np.median(np.linalg.norm(a - b, axis=1)))
        candidates.append((offset / max(sizes) + abs(growth), growth))
    return min(candidates, key=lambda c: c[0])


@given(seed=st.integers(0, 10**6), hidden=st.integers(0, 13))
def test_the_distances_of_all_pairs_are_those_of_the_formula(seed: int, hidden: int) -> None:
    rng = np.random.default_rng(seed)

    def choose() -> Array:
        return (rng.permutation(JOINTS) >= rng.integers(0, hidden + 1)).astype(float)

    people = [ExpectedPerson(make_body(rng, x, 0.2), choose()) for x in (0.0, 0.5, 2.0)]
    seen = [(make_body(rng, x), choose()) for x in (0.1, 0.4)]
    distances, growths = measure_distances(people, seen, MIRROR)
    expected = np.array([[compute_slowly(p, *d) for p in people] for d in seen])
    assert distances == pytest.approx(expected[..., 0], rel=1e-5)
    assert growths == pytest.approx(expected[..., 1], abs=1e-5)


def test_a_person_is_expected_where_the_movement_goes(rng: np.random.Generator) -> None:
    body, step_s = make_body(rng), 1 / 30
    frames = np.stack([body + [0.02 * i, -0.01 * i] for i in range(6)])
    weight = np.ones((6, JOINTS))
    weight[3:, 2] = 0  # this joint was seen 3 frames before the newest
    weight[:, 5] = 0  # and this one never
    for gap in (1, 2, 100):
        age_s: Array = (np.arange(6.0)[::-1] + gap) * step_s
        person = expect_person(frames, weight, age_s)
        moved = np.array([0.02, -0.01]) / step_s
        known = np.arange(JOINTS) != 5
        at_newest = body + [0.1, -0.05] + moved * min(gap * step_s, VELOCITY_SPAN_S)
        assert person.points[known & (np.arange(JOINTS) != 2)] == pytest.approx(
            at_newest[known & (np.arange(JOINTS) != 2)]
        )
        held = body[2] + [0.04, -0.02] + moved * min((gap + 3) * step_s, VELOCITY_SPAN_S)
        assert person.points[2] == pytest.approx(held)
        assert person.weight.tolist() == known.astype(float).tolist()


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 7), st.booleans())
def test_the_pairs_are_those_of_the_least_sum(seed: int, detections: int, people: int, has_ties: bool) -> None:
    cost = np.random.default_rng(seed).random((detections, people)) * 3
    if has_ties:
        cost = np.minimum(np.round(cost), 2)
    expected: list[int | None] = [None] * detections
    for row, column in zip(*linear_sum_assignment(cost), strict=True):
        expected[row] = column
    assert choose_pairs(cost, np.ones_like(cost, bool)) == expected
    cost[-1, 0] = [math.nan, math.inf][seed % 2]
    with pytest.raises(ValueError, match='not finite'):
        choose_pairs(cost, np.ones_like(cost, bool))
