# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the measurement of a frame by stage."""

from __future__ import annotations

import itertools
import time

import pytest
from experiments import stages
from experiments.stages import FRAME, STAGES, StageTimer


def test_time_in_a_nested_function_counts_for_that_one_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count()
    monkeypatch.setattr(time, 'thread_time', lambda: float(next(clock)))  # every reading is 1 s after the last
    timer = StageTimer()
    inner = timer.wrap(lambda x: x + 1, 'inner')
    outer = timer.wrap(lambda x: inner(inner(x)), 'outer')
    assert outer(5) == 7
    assert timer.seconds == {'outer': 3.0, 'inner': 2.0}
    assert not timer.finished.acquire(blocking=False)


@pytest.mark.ros
def test_every_name_in_the_table_exists_and_is_restored() -> None:
    owners = [stages._find_owner(name) for name in (FRAME, *itertools.chain(*STAGES.values()))]
    before = [owner.__dict__[attribute] for owner, attribute in owners]
    with StageTimer().attached(STAGES):
        during = [owner.__dict__[attribute] for owner, attribute in owners]
    assert all(a is not b for a, b in zip(before, during, strict=True))
    assert [owner.__dict__[attribute] for owner, attribute in owners] == before
