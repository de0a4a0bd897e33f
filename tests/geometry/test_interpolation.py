# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Linear interpolation against numpy's, column by column, and the nearest of some times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.geometry.interpolation import find_nearest, interpolate_linearly, interpolate_rotations


@given(
    steps=st.lists(st.floats(1e-6, 10.0), min_size=0, max_size=12),
    times=st.lists(st.floats(-5.0, 50.0), min_size=1, max_size=12),
)
def test_each_column_is_interpolated_and_kept_beyond_the_ends(steps: list[float], times: list[float]) -> None:
    sample_times = np.concatenate([[0.0], np.cumsum(steps)])
    samples = np.random.default_rng(len(steps)).normal(size=(len(sample_times), 3))
    found = interpolate_linearly(np.array(times), sample_times, samples)
    expected = np.stack([np.interp(times, sample_times, column) for column in samples.T], axis=-1)
    assert found == pytest.approx(expected, abs=1e-9)


def test_the_nearest_time_is_that_of_a_comparison_with_all(rng: np.random.Generator) -> None:
    times = np.arange(400) / 8  # multiples of a power of two, so that many are equally near
    for share in (0.003, 0.1, 0.5, 1.0):
        known = times[(rng.random(400) < share) | (np.arange(400) == 77)]
        np.testing.assert_array_equal(find_nearest(times, known), np.abs(times[:, None] - known).argmin(axis=1))


def test_rotations_are_interpolated_on_the_shortest_arc(rng: np.random.Generator) -> None:
    known, times = np.array([0.0, 0.5, 0.6, 2.0]), np.r_[np.sort(rng.uniform(0, 2, 30)), 0.5, 2.0]
    turns = Rotation.random(4, random_state=1)
    found = interpolate_rotations(times, known, turns.as_matrix())
    assert found == pytest.approx(Slerp(known, turns)(times).as_matrix(), abs=1e-9)
