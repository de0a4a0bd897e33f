# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People who contradict a given vertical for seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.people import Person3D
from mocap_ros.tracking.vertical_check import LEAST_S, VerticalCheck
from tests.support.people import make_person_3d
from tests.support.upright_body import UPRIGHT

UP = np.array([0.0, 0.0, 1.0])
STEP_NS = 100_000_000


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


def test_it_holds_at_any_rate_and_begins_anew_with_the_stamps() -> None:
    lying = [make_leaning(180)]
    for hz in (1, 2, 5, 200):
        check = VerticalCheck()
        assert [check.advance(i * 10**9 // hz, lying, UP) for i in range(10 * hz)][-1] is not None
    assert check.advance(0, lying, UP) is None, 'the stamps began anew'
    assert not any(VerticalCheck().advance(t, lying, UP) for t in range(0, 10**12, 60 * 10**9))
