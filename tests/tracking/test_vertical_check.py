# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What must be so for most people over seconds, such as that they contradict a given vertical."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.people import Person3D
from mocap_ros.tracking.vertical_check import LEAST_S, LastingCondition, VerticalCheck
from tests.support.people import make_person_3d
from tests.support.upright_body import UPRIGHT

UP = np.array([0.0, 0.0, 1.0])
STEP_NS = 100_000_000
LEAST_CONDITION = 2.5  # s, in tests of other conditions


def make_leaning(angle_deg: float) -> Person3D:
    """Return a person who leans to the side by an angle."""
    turn = Rotation.from_rotvec([np.radians(angle_deg), 0, 0])
    return replace(make_person_3d('anna'), joints=turn.apply(UPRIGHT))


def advance(check: VerticalCheck, people: list[Person3D], seconds: float, first: int = 0) -> float | None:
    found = None
    for frame in range(first, first + round(seconds * 10)):
        found = check.advance(frame * STEP_NS, people, UP)
    return found


@given(st.floats(0, 180))
@settings(max_examples=30)
def test_the_angle_between_people_and_the_vertical_decides(angle_deg: float) -> None:
    found = advance(VerticalCheck(), [make_leaning(angle_deg)], LEAST_S + 3)
    if angle_deg < 33:
        assert found is None
    if angle_deg > 47:
        assert found == pytest.approx(angle_deg, abs=6)  # as the body stands a little behind its feet


def test_it_takes_a_while_and_who_stands_among_people_who_lie_confirms_it() -> None:
    assert advance(VerticalCheck(), [make_leaning(180)], LEAST_S - 0.5) is None
    assert advance(VerticalCheck(), [make_leaning(90), make_leaning(0)], 20) is None
    unsure = replace(make_leaning(180), tentative=True), replace(make_leaning(180), predicted=True)
    assert advance(VerticalCheck(), [*unsure], 20) is None
    check = VerticalCheck()
    assert advance(check, [make_leaning(0)], 10) is None
    assert advance(check, [make_leaning(90)], 5, 100) is None, 'a person who lies down'
    assert advance(check, [make_leaning(90)], 60, 150) is not None


def advance_condition(condition: LastingCondition, is_so: list[bool], seconds: float, first: int = 0) -> bool:
    frames = range(first, first + round(seconds / 0.1) + 1)
    return [condition.advance(round(i * 0.1 * 1e9), is_so) for i in frames][-1]


def test_a_condition_needs_most_people_for_seconds() -> None:
    assert not advance_condition(LastingCondition(5.0, LEAST_CONDITION), [True], LEAST_CONDITION - 0.1)
    assert advance_condition(LastingCondition(5.0, LEAST_CONDITION), [True], LEAST_CONDITION + 2)
    assert advance_condition(LastingCondition(5.0, LEAST_CONDITION), [True] * 9 + [False], LEAST_CONDITION + 2)
    assert not advance_condition(LastingCondition(5.0, LEAST_CONDITION), [True, True, False], 60)
    assert not advance_condition(LastingCondition(5.0, LEAST_CONDITION), [], 60)
    one_frame_a_minute = [
        LastingCondition(5.0, LEAST_CONDITION).advance(t, [True]) for t in range(0, 10**12, 60 * 10**9)
    ]
    assert not any(one_frame_a_minute)
    for hz in (1, 2, 5, 200):
        condition = LastingCondition(5.0, LEAST_CONDITION)
        assert [condition.advance(i * 10**9 // hz, [True]) for i in range(10 * hz)][-1], 'at any rate'


def test_a_condition_ends_with_its_cause_and_with_stamps_that_begin_anew() -> None:
    condition = LastingCondition(5.0, LEAST_CONDITION)
    assert advance_condition(condition, [True], 60)
    assert not advance_condition(condition, [False], 3, first=300)
    assert advance_condition(condition, [True], 60, first=400)
    assert not condition.advance(0, [True])
