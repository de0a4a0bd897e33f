# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the measurement of a frame by stage."""

from __future__ import annotations

import itertools
import time

import pytest
from experiments import stages
from experiments.stages import FRAME, OTHER, STAGES, StageTimer

from mocap_ros.bags.recorder import Recorder


def test_time_in_a_nested_function_counts_for_that_one_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count()
    monkeypatch.setattr(time, 'thread_time', lambda: float(next(clock)))  # every reading is 1 s after the last
    timer = StageTimer()
    inner = timer.wrap(lambda x: x + 1, 'inner')
    outer = timer.wrap(lambda x: inner(inner(x)), 'outer')
    assert outer(5) == 7
    assert timer.seconds == {'outer': 3.0, 'inner': 2.0}
    assert not timer.finished.acquire(blocking=False)


def test_time_counts_and_the_frame_ends_when_a_function_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count()
    monkeypatch.setattr(time, 'thread_time', lambda: float(next(clock)))
    timer = StageTimer()
    inner = timer.wrap(lambda: 1 / 0, 'inner')
    frame = timer.wrap(inner, OTHER)
    with pytest.raises(ZeroDivisionError):
        frame()
    assert timer.seconds == {OTHER: 2.0, 'inner': 1.0}
    assert timer.finished.acquire(blocking=False)


@pytest.mark.ros
def test_every_name_in_the_table_exists_and_is_restored() -> None:
    owners = [stages._find_owner(name) for name in (FRAME, *itertools.chain(*STAGES.values()))]
    before = [owner.__dict__[attribute] for owner, attribute in owners]
    with StageTimer().attached(STAGES):
        during = [owner.__dict__[attribute] for owner, attribute in owners]
    assert all(a is not b for a, b in zip(before, during, strict=True))
    assert [owner.__dict__[attribute] for owner, attribute in owners] == before


@pytest.mark.ros
@pytest.mark.parametrize('name', ['mocap_ros.bags.background:Recorder.missing', 'mocap_ros.ros.live:missing'])
def test_a_missing_name_is_an_error_and_leaves_nothing_wrapped(name: str) -> None:
    write = Recorder.write
    table = {'record': ('mocap_ros.bags.background:Recorder.write', name)}
    with pytest.raises(AttributeError, match='missing'), StageTimer().attached(table):
        pass
    assert Recorder.write is write
