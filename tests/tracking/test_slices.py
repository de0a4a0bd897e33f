# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of work in slices of known cost."""

from collections.abc import Generator

import pytest

from mocap_ros.tracking.slices import PIECES_OF_STEP, STEP_BASE, compute_piece_cost, do_in_slices, finish_slices


def count_steps(done: list[int]) -> Generator[None, None, str]:
    for number in range(3):
        done.append(number)
        yield
    return 'end'


def test_each_piece_of_stepwise_work_is_a_slice_that_tells_its_cost_before() -> None:
    done: list[int] = []
    slices = do_in_slices(count_steps(done), 7)
    counts = [(next(slices), len(done)) for _ in range(4)]
    assert counts == [(7, 0), (7, 1), (7, 2), (7, 3)]
    with pytest.raises(StopIteration, match='end'):
        next(slices)
    assert finish_slices(do_in_slices(count_steps([]), 7)) == 'end'


def test_the_cost_grows_with_frames_and_base_poses() -> None:
    assert compute_piece_cost(11, 40) == (STEP_BASE + 11 * 44**2) / PIECES_OF_STEP
