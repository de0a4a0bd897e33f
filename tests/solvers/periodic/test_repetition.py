# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How well motions repeat themselves: walks, seams, standing still, and what is too short to tell."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mocap_ros.solvers.periodic.repetition import (
    MAX_STRETCH,
    NEWEST_S,
    measure_best_repetition,
    measure_repetition,
)

CADENCE = 0.9  # Hz


def swing(times: np.ndarray, cadence: float = CADENCE) -> np.ndarray:
    """Weights (F, 3) of a motion with two harmonics."""
    phase = 2 * np.pi * cadence * times[:, None]
    return np.concatenate([np.sin(phase), 0.5 * np.cos(phase), 0.3 * np.sin(2 * phase + 1)], axis=1)


@pytest.mark.parametrize('wrong', [1 - 0.9 * MAX_STRETCH, 1.0, 1 + 0.9 * MAX_STRETCH])
def test_a_periodic_motion_repeats_itself_also_where_its_cadence_is_a_little_wrong(
    rng: np.random.Generator, wrong: float
) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.05, 60))
    assert measure_repetition(times, swing(times), wrong * CADENCE) > 0.97
    noisy = swing(times) + rng.normal(0, 0.1, (60, 3))
    assert 0.8 < measure_repetition(times, noisy, CADENCE) < 1


def test_the_formula(rng: np.random.Generator) -> None:
    """A motion sampled where it is compared: without noise of the interpolation."""
    times = np.arange(60) / 30
    theta = rng.normal(size=(60, 4))
    newest, cycle = theta[[59 - 2 * i for i in range(7)]], theta[[59 - 2 * i for i in range(21)]]  # 15 a second
    spread = ((cycle - cycle.mean(axis=0)) ** 2).sum(axis=1).mean()
    best = max(
        1 - ((newest - theta[[59 - lag - 2 * i for i in range(7)]]) ** 2).sum(axis=1).mean() / (2 * spread)
        for lag in (27, 30, 33)
    )
    assert measure_repetition(times, theta, 1.0) >= best - 1e-9
    repeated = np.tile(theta[:30], (2, 1))
    assert measure_repetition(times, repeated, 1.0) == pytest.approx(1)


@pytest.mark.parametrize('other', ['still', 'elsewhere', 'faster'])
def test_another_motion_after_a_seam_does_not_repeat_the_walk(other: str) -> None:
    times, seam_s = np.arange(66) / 30, 66 / 30 - 2 * NEWEST_S
    theta, after = swing(times), times > seam_s
    theta[after] = {
        'still': np.tile(swing(np.array([seam_s]))[0], (after.sum(), 1)),
        'elsewhere': swing(times[after]) + [2.0, 0, 0],
        'faster': -swing(times[after], 1.9),
    }[other]
    assert measure_repetition(times, theta, CADENCE) < 0.5


def test_what_is_too_short_or_does_not_move_is_not_known() -> None:
    times = np.arange(60) / 30
    assert math.isnan(measure_repetition(times, swing(times), 0.6))
    assert math.isnan(measure_repetition(times[-5:], swing(times[-5:]), CADENCE))
    assert math.isnan(measure_repetition(times, np.ones((60, 3)), CADENCE))


@pytest.mark.parametrize('cadence', [0.55, 0.65, 0.9, 1.4, 2.1])
@pytest.mark.parametrize('rate', [12.0, 30.0, 100.0])
def test_the_best_repetition_needs_no_cadence(rng: np.random.Generator, cadence: float, rate: float) -> None:
    times = np.arange(0, 2.2, 1 / rate)
    assert measure_best_repetition(times, swing(times, cadence)) > 0.9
    drift = np.cumsum(1 + rng.normal(size=(len(times), 3)), axis=0)
    assert measure_best_repetition(times, drift) < 0.2
    assert measure_best_repetition(times, swing(times)) >= measure_repetition(times, swing(times), 1.0) - 0.01


@pytest.mark.parametrize('span_s', [0.3, 1.0, 1.3, 1.5, 1.8, 2.0])
def test_no_walk_is_excluded_because_its_cycle_was_not_seen(span_s: float) -> None:
    times = np.arange(0, span_s + 1e-9, 1 / 30)
    for cadence in np.arange(0.55, 2.2, 0.05):
        assert not measure_best_repetition(times, swing(times, cadence)) < 0.2, cadence
