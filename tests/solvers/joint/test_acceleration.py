# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The limit to accelerations: how it gives way to motion, and the measurement of that motion."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.solvers.joint.acceleration import (
    ACTIVITY_SPAN_S,
    MAX_NOISE_RATIO,
    Acceleration,
    measure_activity,
)
from mocap_ros.solvers.joint.batch import Batch


def test_the_limit_gives_way_to_fast_motion_and_holds_under_noise() -> None:
    batch = Batch.of_times([np.arange(5) / 10])
    term = Acceleration.build(2.0, 3.0, batch)
    unlimited = np.sqrt(2.0) * batch.velocity_change
    np.testing.assert_allclose(term.factors, unlimited, rtol=1e-12)
    active = term.with_activity(np.array([0.0, 9.0, 81.0, 0.0, 0.0]))
    share = (active.factors[:3] / unlimited[:3]) ** 2
    np.testing.assert_allclose(share[:, 0], [1.0, 1 / 2, 1 / 82], rtol=1e-12)
    for noise_ratio, limit in ((0.5, 3 * 0.5), (1.5, 3 * 1.5), (20.0, 3 * MAX_NOISE_RATIO)):
        noisy = active.with_noise_ratio(np.full(5, noise_ratio))
        share = (noisy.factors[:3] / unlimited[:3]) ** 2
        expected = [1.0, 1 / (1 + (3 / limit) ** 4), 1 / (1 + (9 / limit) ** 4)]
        np.testing.assert_allclose(share[:, 0], expected, rtol=1e-12)


def test_activity_is_the_mean_square_acceleration_nearby(rng: np.random.Generator) -> None:
    """Two sequences, one at rest and one with 2 m/s^2 in one of two values from its second second on."""
    times = [np.sort(rng.uniform(0, 4, 40)), np.arange(41) / 10]
    moved = np.where(times[1] < 2, 0.0, (times[1] - 2) ** 2)
    values = np.concatenate([np.ones((40, 2)), np.stack([moved, np.zeros(41)], axis=1)])
    coarse, fine = Batch.of_times(times), Batch.of_times([np.arange(120) / 30, np.arange(120) / 30])
    found = measure_activity(values, coarse, fine)
    np.testing.assert_allclose(found[:120], 0.0, atol=1e-12)
    later, earlier = fine.times[120:] > 2 + ACTIVITY_SPAN_S + 0.11, fine.times[120:] < 2 - ACTIVITY_SPAN_S - 0.11
    inner = later & (fine.times[120:] < 4 - ACTIVITY_SPAN_S - 0.11)
    assert found[120:][inner] == pytest.approx(4.0, rel=1e-9)
    np.testing.assert_allclose(found[120:][earlier], 0.0, atol=1e-12)


def test_too_few_frames_have_no_activity() -> None:
    coarse, fine = Batch.of_times([np.array([0.0, 0.1])]), Batch.of_times([np.arange(4) / 30])
    np.testing.assert_array_equal(measure_activity(np.ones((2, 3)), coarse, fine), 0.0)
