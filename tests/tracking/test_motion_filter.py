# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The filter of the newest frame against its formulas, on exact motion, on noise and at uneven times."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import Config, with_settings
from mocap_ros.engine.motion import filter_motion
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import HIPS
from mocap_ros.tracking.motion_filter import MOTION
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS, see

JOINTS = 15


def filter_states(times: np.ndarray, joints: np.ndarray, image_noise: float = np.inf) -> np.ndarray:
    """Return the filters (F,) `MOTION` of all frames of a person, with an image noise in m at the body."""
    own, filters = np.full((1, MOTION.itemsize // 8), np.nan), []
    for time, pose in zip(times, joints, strict=True):
        advance(own, time, pose, image_noise)
        filters.append(own.copy())
    return np.concatenate(filters).view(MOTION)[:, 0]


def advance(own: np.ndarray, time: float, pose: np.ndarray, image_noise: float) -> np.ndarray:
    """Advance a filter (1, R), and return its joints (15, 3)."""
    known = np.array([time]), pose[None].copy(), np.array([image_noise]), np.array(HIPS)
    return np.asarray(filter_motion(own, *known, is_steady=True)[0][0])


def advance_plainly(
    state: np.ndarray, recent: np.ndarray, times: np.ndarray, max_jitter: float, *, is_centre: bool
) -> np.ndarray:
    """The formulas of the module for one point: state (5, 3), recent (3, 3); the gains are those of the poles."""
    x, v, second, speed, _ = state
    h = times[-1] - times[-2]
    c = np.array([1 / np.prod(np.delete(times[i] - times, i)) for i in range(3)])
    squares = (np.sqrt(6) * c @ recent / np.linalg.norm(c)) ** 2
    second = second + (1 - np.exp(-h / 0.113)) * (np.minimum(squares, 6.0 * second) - second)
    speed = speed + (1 - np.exp(-h / 0.077)) * (v**2 - speed)
    s_0 = 0.2 if is_centre else 0.055
    s = np.sqrt(speed.sum() + s_0**2)
    if is_centre:
        w, constants = np.sqrt(second / 6), (20.0, 1.0, 0.5)
        factors = (1.1, 1.1, 1.1), (0.14, 0.14, 0.55), 0.07
    else:
        w = np.full(3, min(np.sqrt(second.mean() / 6), max_jitter))
        constants = 40.0, 0.5, 6.4
        factors = (1.6, 1.6, 0.5), (0.0, 0.0, 0.62), 0.0
    stiffness, zeta, b = constants
    omega = stiffness * s**0.73 / (w / 0.005) ** 0.45
    poles = np.exp([(-zeta + sign * 1j * np.sqrt(1 - zeta**2)) * omega * h for sign in (1, -1)])
    expected = x + (1 - np.exp(-b * h)) / b * v
    x = expected + (1 - poles[0] * poles[1]).real * (recent[-1] - expected)
    v = np.exp(-b * h) * v + ((1 - poles[0]) * (1 - poles[1])).real / h * (recent[-1] - expected)
    by_jitter, by_speed, floor = factors
    variance = (np.array(by_jitter) * w * omega) ** 2 + (np.array(by_speed) * s) ** 2 + floor**2
    return np.stack([x, v, second, speed, variance])


@pytest.mark.parametrize('max_jitter', [0.002, 1.0])
def test_a_step_is_that_of_the_formulas(rng: np.random.Generator, max_jitter: float) -> None:
    before = np.zeros(1, MOTION)
    state, before['times'] = before['state'][0], [np.nan, 1.0, 1.03]
    state[:] = rng.uniform(0.5, 1, (5, 16, 3))
    state[2] = rng.uniform(1e-5, 1e-3, (16, 3))
    state[1] = rng.uniform(-0.3, 0.3, (16, 3))  # m/s; slow enough for springs that turn by less than a right angle
    state[3] = state[1] ** 2
    state[0] -= [*[state[0, :-1].mean(axis=0)] * 15, [0, 0, -2]]
    before['recent'] = rng.normal(0, 0.02, (3, 16, 3)) + state[0]
    state = state.copy()
    joints = state[0, :-1] + state[0, -1] + rng.normal(0, 0.02, (15, 3))
    advance(before.view(float)[None], 1.07, joints, 2 * max_jitter)
    found, centre = before[0], joints.mean(axis=0)
    np.testing.assert_allclose(found['recent'][2], [*(joints - centre), centre], atol=1e-12)
    for p in range(16):
        points = state[:, p], found['recent'][:, p], np.array([-0.07, -0.04, 0.0])
        expected = advance_plainly(*points, max_jitter, is_centre=p == 15)
        np.testing.assert_allclose(found['state'][:, p], expected, rtol=1e-9)


def test_the_filter_begins_anew_where_another_solution_is_found(rng: np.random.Generator) -> None:
    """Depth from 100 m to 5 m, and after a gap: no filtered frame is on the way."""
    poses = rng.normal(0, 0.3, (1, JOINTS, 3)) + rng.normal(0, 0.01, (40, JOINTS, 3))
    poses[:20] += [0, 0, 100.0]
    poses[20:] += [0, 0, 5.0]
    times = np.arange(40) / 30
    for gap_s in (0.0, 2.0):
        later = times + gap_s * (np.arange(40) >= 20)
        own = np.full((1, MOTION.itemsize // 8), np.nan)
        filtered = [advance(own, time, pose, np.inf) for time, pose in zip(later, poses, strict=True)]
        assert np.abs(filtered - poses).max() < 0.2


@settings(max_examples=40)
@given(
    steps=st.lists(st.floats(1e-6, 30.0), min_size=2, max_size=30),
    size=st.sampled_from([0.0, 1e-9, 0.1, 100.0]),
)
def test_joints_stay_finite_and_variances_positive(steps: list[float], size: float) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    poses = np.random.default_rng(0).normal(0, size, (len(times), JOINTS, 3))
    states = filter_states(times, poses, 0.02)['state']
    assert np.isfinite(states).all()
    assert (states[:, 2:] >= 0).all(), 'mean squares and variances'


def test_the_tracker_filters_its_output_and_nothing_else(walk_model: BasePoses, rng: np.random.Generator) -> None:
    """The joints jitter less; the solution behind them, and what a longer lag shows, are the same."""
    points = make_walk(walk_model, frames=60).points + rng.normal(0, 2, (60, JOINTS, 2))  # px
    outputs, solutions = {}, {}
    for lag, steady in itertools.product((0.0, 0.2), (False, True)):
        values = {'tracker.lag': lag, 'tracker.steady_output': steady, 'solver.prior': 'pca'}
        tracker = Tracker(walk_model, with_settings(Config(), {'solver.components': 8, **values}))
        found = [tracker.update(i * STEP_NS, [see(image)], CAMERA) for i, image in enumerate(points)]
        outputs[lag, steady] = np.array([frame[0].joints for frame in found if frame])
        solutions[lag, steady] = tracker.tracks[0].solved.theta
    np.testing.assert_array_equal(solutions[0.0, False], solutions[0.0, True])
    np.testing.assert_array_equal(outputs[0.2, False], outputs[0.2, True])
    jitter = [np.abs(np.diff(outputs[0.0, steady][20:], 2, axis=0)).mean() for steady in (False, True)]
    assert jitter[1] < 0.7 * jitter[0]
