# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The periodic solver on walks and on extreme input, and how well motions repeat themselves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import periodic
from mocap_ros.solvers.periodic.repetition import (
    MAX_STRETCH,
    NEWEST_S,
    measure_best_repetition,
    measure_repetition,
)
from mocap_ros.solvers.window import Window
from tests.support.synthetic_walk import BODY_TO_OPTICAL, Walk, compute_mpjpe

CADENCE = 0.9  # Hz


def make_walk(model: BasePoses, frames: int = 70, seed: int = 0) -> Walk:
    """Return weights, cameras, points and times of a walk: four weights, two harmonics each, irregular times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.02, 0.05, frames))
    angle = 2 * np.pi * CADENCE * times[:, None]
    theta = np.zeros((frames, len(model.std)))
    phase = rng.uniform(0, 6, (2, 4))
    theta[:, :4] = model.std[:4] * (np.sin(angle + phase[0]) + 0.4 * np.sin(2 * angle + phase[1]))
    rotation = np.tile(BODY_TO_OPTICAL @ rotation_from_vector(np.array([0, 0, 0.9])), (frames, 1, 1))
    cameras = WeakPerspectiveCameras(np.full(frames, 200.0), rotation)
    points = cameras.project(model.poses(theta)) + [320.0, 240.0]
    return theta, cameras, points, times


@pytest.mark.parametrize(('missing', 'measured_mm'), [(0.0, 24.6), (0.2, 27.1)])
def test_finds_cadence_and_motion(walk_model: BasePoses, missing: float, measured_mm: float) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    weight = (np.random.default_rng(2).random(points.shape[:2]) >= missing).astype(float)
    if missing:
        weight[:, [3, 4]] = 0
    (result,) = periodic.solve([Window(points, weight, times)], walk_model, SolverConfig(components=10))
    assert result.cadence == pytest.approx(CADENCE, rel=0.01)
    assert compute_mpjpe(result, walk_model, theta, cameras) < 1.1 * measured_mm
    assert (np.diff(result.history) <= 0).all()


@given(
    frames=st.integers(1, 6),
    spread=st.floats(-307, 307),
    offset=st.floats(-307, 307),
    weight=st.floats(-300, 300),
    step=st.sampled_from([1e-300, 1e-9, 1 / 30, 1e9, 1e300]),
    given_noise=st.sampled_from([None, 1e-300, 1.0, 1e300]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=30)
def test_extreme_input_is_rejected_or_gives_finite_results(
    walk_model: BasePoses,
    frames: int,
    spread: float,
    offset: float,
    weight: float,
    step: float,
    given_noise: float | None,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    points = 10**offset + 10**spread * rng.uniform(-1, 1, (frames, 15, 2))
    seen = np.full((frames, 15), 10**weight)
    window = Window(points, seen, np.array([step * frame for frame in range(frames)]), noise=given_noise)
    config = SolverConfig(components=6, max_iterations=8)
    try:
        (result,) = periodic.solve([window], walk_model, config)
    except InputError:
        return
    for values in (result.joints, result.cameras.scale, result.translation, result.history):
        assert np.isfinite(values).all()
    assert (np.diff(result.history) <= 0).all()


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
