# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what must be so for most people over seconds."""

import pytest

from mocap_ros.tracking.vertical_check import LastingDoubt

STEP_S = 0.1
MEMORY_S, LEAST_S = 5.0, 2.5


def advance(doubt: LastingDoubt, is_so: list[bool], seconds: float, first: int = 0) -> bool:
    frames = range(first, first + round(seconds / STEP_S) + 1)
    return [doubt.advance(round(i * STEP_S * 1e9), is_so) for i in frames][-1]


def test_a_doubt_needs_most_people_for_seconds() -> None:
    assert not advance(LastingDoubt(MEMORY_S, LEAST_S), [True], LEAST_S - STEP_S)
    assert advance(LastingDoubt(MEMORY_S, LEAST_S), [True], LEAST_S + 2)
    assert advance(LastingDoubt(MEMORY_S, LEAST_S), [True] * 9 + [False], LEAST_S + 2)
    assert not advance(LastingDoubt(MEMORY_S, LEAST_S), [True, True, False], 60)
    assert not advance(LastingDoubt(MEMORY_S, LEAST_S), [], 60)
    one_frame_a_minute = [LastingDoubt(MEMORY_S, LEAST_S).advance(t, [True]) for t in range(0, 10**12, 60 * 10**9)]
    assert not any(one_frame_a_minute)


@pytest.mark.parametrize('hz', [1, 2, 5, 200])
def test_a_doubt_comes_at_any_rate(hz: int) -> None:
    doubt = LastingDoubt(MEMORY_S, LEAST_S)
    assert [doubt.advance(i * 10**9 // hz, [True]) for i in range(10 * hz)][-1]


def test_a_doubt_ends_with_its_cause_and_with_stamps_that_begin_anew() -> None:
    doubt = LastingDoubt(MEMORY_S, LEAST_S)
    assert advance(doubt, [True], 60)
    assert not advance(doubt, [False], 3, first=300)
    doubt = LastingDoubt(MEMORY_S, LEAST_S)
    assert advance(doubt, [True], 60)
    assert not doubt.advance(0, [True])
