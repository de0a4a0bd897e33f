"""The filter of the newest frame against its formulas, on exact motion, on noise and at uneven times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking import motion_filter as module
from mocap_ros.tracking.motion_filter import MotionFilter, advance_state
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S
from tests.support.synthetic_walk import make_walk

JOINTS = 15
STEP_NS = 33_333_333
CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
CONFIG = with_values(Config(), {'solver.components': 8, 'solver.prior': 'pca'})


def filter_all(times: np.ndarray, joints: np.ndarray, image_noise: float = np.inf) -> np.ndarray:
    """Return the filtered joints of all frames, with an image noise in m at the body."""
    stamps = [round(t * NS_PER_S) for t in times]
    motion = MotionFilter.begin(stamps[0], joints[0])
    out = [motion.joints]
    for stamp, pose in zip(stamps[1:], joints[1:], strict=True):
        motion = motion.advance(stamp, pose, image_noise)
        out.append(motion.joints)
    return np.array(out)


def swing_joints(times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Joints (F, 15, 3) m that swing by 0.2 m once a second about a centre that moves at 1 m/s."""
    phase = rng.uniform(0, 2 * np.pi, (JOINTS, 3))
    swing = 0.2 * np.sin(2 * np.pi * times[:, None, None] + phase)
    swing -= swing.mean(axis=1, keepdims=True)
    place = rng.normal(size=(JOINTS, 3)) + [0, 0, 4]
    return place + swing + times[:, None, None] * [1.0, 0, 0]


def advance_plainly(
    state: np.ndarray,
    recent: np.ndarray,
    times: np.ndarray,
    limits: tuple[float, float],
    b: float,
    max_noise: float,
) -> np.ndarray:
    """The formulas of the module for one coordinate: state (7,), recent (4,)."""
    x, v, pxx, pxv, pvv, second, third = state
    h = times[-1] - times[-2]
    differences = []
    for count, squares in ((3, 6.0), (4, 20.0)):
        t = times[-count:]
        c = np.array([1 / np.prod(np.delete(t[i] - t, i)) for i in range(count)])
        c *= np.sqrt(squares / (c @ c))
        differences.append(float(c @ recent[-count:]) ** 2)
    rate = 1 - np.exp(-h / module.NOISE_MEMORY_S)
    second += rate * (min(differences[0], module.MAX_RISE * second) - second)
    third += rate * (min(differences[1], module.MAX_RISE * third) - third)
    mean = (times[-1] - times[0]) / 3
    noise, motion = np.linalg.solve(np.array([[6, 2 / 3], [20, 1]]), np.array([second, third]))  # r and q h^3
    motion = np.clip(motion, limits[0] * mean**3, limits[1] * mean**3)
    noise = np.clip((third - motion) / 20, module.MIN_NOISE_M**2, max_noise**2)
    q = module.ACCELERATION_SHARE * motion / mean**3
    f = np.array([[1, h], [0, np.exp(-b * h)]])
    p = f @ np.array([[pxx, pxv], [pxv, pvv]]) @ f.T + q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    at = np.array([x + (1 - np.exp(-b * h)) / b * v, np.exp(-b * h) * v])
    gain = p[:, 0] / (p[0, 0] + noise)
    at = at + gain * (recent[-1] - at[0])
    p = p - np.outer(gain, p[0])
    return np.array([*at, p[0, 0], p[0, 1], p[1, 1], second, third])


@pytest.mark.parametrize('max_noise', [0.002, 1.0])
def test_a_step_is_that_of_the_formulas(rng: np.random.Generator, max_noise: float) -> None:
    times = np.array([-0.11, -0.07, -0.04, 0.0])
    state = rng.uniform(0.5, 1, (7, 3, 3))
    state[2:5] = [[[4e-4]], [[1e-3]], [[0.3]]]
    state[5:] = rng.uniform(1e-5, 1e-3, (2, 3, 3))
    recent = rng.normal(0, 0.02, (4, 3, 3)) + state[0]
    found = advance_state(state, recent, times, max_noise)
    for p, c in np.ndindex(3, 3):
        limits, fade, most = (module.MIN_DENSITY, module.MAX_DENSITY), module.VELOCITY_FADE_PER_S, max_noise
        if p == 2:
            limits, fade = (module.CENTRE_DENSITY, module.CENTRE_DENSITY), module.CENTRE_VELOCITY_FADE_PER_S
            most = np.inf
        expected = advance_plainly(state[:, p, c], recent[:, p, c], times, limits, fade, most)
        assert found[:, p, c] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize('rate', [30.0, 100.0])
@pytest.mark.parametrize('noise', [0.005, 0.02])
def test_tremble_is_lowered_and_motion_is_kept(rng: np.random.Generator, rate: float, noise: float) -> None:
    times = np.arange(int(6 * rate)) / rate
    walk = swing_joints(times, rng)
    noisy = walk + rng.normal(0, noise, walk.shape)
    filtered, settled = filter_all(times, noisy), slice(int(2 * rate), None)
    errors = [np.sqrt(((p - walk)[settled] ** 2).mean()) for p in (noisy, filtered)]
    assert errors[1] < 1.1 * errors[0], 'the lag costs no more than the noise that is taken out'
    shaking = [np.abs(np.diff(p[settled], 2, axis=0)).mean() for p in (noisy, filtered, walk)]
    assert shaking[1] - shaking[2] < 0.6 * (shaking[0] - shaking[2])


def test_exact_motion_passes_at_uneven_times(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.05, 200))
    walk = swing_joints(times, rng)
    found = filter_all(times, walk)
    assert np.abs(found - walk)[60:].max() < 0.01, 'of swings of 0.2 m'


def test_jerky_limbs_are_not_taken_for_noise_where_the_image_is_exact(rng: np.random.Generator) -> None:
    times = np.arange(150) / 30
    phase = rng.uniform(0, 2 * np.pi, (JOINTS, 3))
    run = 0.3 * np.abs(np.sin(2 * np.pi * 1.4 * times[:, None, None] + phase))  # m; feet that bounce
    run += [0, 0, 4.0] - run.mean(axis=1, keepdims=True)
    errors = [np.abs(filter_all(times, run, noise) - run)[60:].mean() for noise in (0.004, np.inf)]
    assert errors[0] < 0.4 * errors[1]


def test_after_a_gap_the_filter_follows_at_once(rng: np.random.Generator) -> None:
    times = np.arange(90) / 30.0
    times[60:] += 2.0
    poses = np.broadcast_to(rng.normal(size=(JOINTS, 3)), (90, JOINTS, 3)).copy()
    poses += rng.normal(0, 0.005, poses.shape)
    poses[60:] += 1.0
    found = filter_all(times, poses)
    assert np.abs(found[60] - poses[60]).max() < 0.1


def test_the_filter_begins_anew_where_another_solution_is_found(rng: np.random.Generator) -> None:
    """Depth from 100 m to 5 m: none of the filtered frames is behind the camera or on the way."""
    poses = rng.normal(0, 0.3, (1, JOINTS, 3)) + rng.normal(0, 0.01, (40, JOINTS, 3))
    poses[:20] += [0, 0, 100.0]
    poses[20:] += [0, 0, 5.0]
    found = filter_all(np.arange(40) / 30, poses)
    assert np.abs(found - poses).max() < 0.2


def test_a_filter_is_not_changed_by_its_successors(rng: np.random.Generator) -> None:
    poses = rng.normal(size=(8, JOINTS, 3))
    motion = MotionFilter.begin(0, poses[0])
    for i in range(1, 6):
        motion = motion.advance(i * 33_000_000, poses[i], 0.02)
    state, recent = motion.state.copy(), motion.recent.copy()
    later = [motion.advance(6 * 33_000_000, poses[n], 0.02).joints for n in (6, 7, 6)]
    np.testing.assert_array_equal(later[0], later[2])
    assert np.abs(later[0] - later[1]).max() > 0
    np.testing.assert_array_equal(motion.state, state)
    np.testing.assert_array_equal(motion.recent, recent)


@settings(max_examples=40, deadline=None)
@given(
    steps=st.lists(st.floats(1e-6, 30.0), min_size=2, max_size=30),
    size=st.sampled_from([0.0, 1e-9, 0.1, 100.0]),
)
def test_joints_stay_finite_and_covariances_positive(steps: list[float], size: float) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    poses = np.random.default_rng(0).normal(0, size, (len(times), JOINTS, 3))
    motion = MotionFilter.begin(0, poses[0])
    for time, pose in zip(times[1:], poses[1:], strict=True):
        motion = motion.advance(max(round(time * NS_PER_S), motion.stamps_ns[-1] + 1), pose, 0.02)
        _, _, pxx, pxv, pvv, second, third = motion.state
        assert np.isfinite(motion.state).all()
        assert (pxx >= 0).all()
        assert (pxx * pvv - pxv**2 >= -1e-9 * pxx * pvv).all()
        assert (second >= 0).all()
        assert (third >= 0).all()


def detect_walk(model: BasePoses, rng: np.random.Generator, frames: int) -> list[Person2D]:
    """A walker as a detector with noise of 2 px gives them."""
    points = make_walk(model, frames=frames)[2]
    return [Person2D('', CMU15.joints, xy + rng.normal(0, 2, xy.shape), np.ones(JOINTS)) for xy in points]


def test_the_tracker_filters_what_it_puts_out_and_nothing_else(
    walk_model: BasePoses, rng: np.random.Generator
) -> None:
    """The joints tremble less; the solution behind them, and what a longer lag shows, are the same."""
    people = detect_walk(walk_model, rng, 60)
    outputs, solutions = {}, {}
    for lag in (0.0, 0.2):
        for steady in (False, True):
            tracker = Tracker(
                walk_model, with_values(CONFIG, {'tracker.lag': lag, 'tracker.steady_output': steady})
            )
            found = [tracker.update(i * STEP_NS, [person], CAMERA) for i, person in enumerate(people)]
            outputs[lag, steady] = np.array([frame[0].joints for frame in found if frame])
            solutions[lag, steady] = tracker.snapshot().tracks[0].solved.theta
    np.testing.assert_array_equal(solutions[0.0, False], solutions[0.0, True])
    np.testing.assert_array_equal(outputs[0.2, False], outputs[0.2, True])
    shaking = [np.abs(np.diff(outputs[0.0, steady][20:], 2, axis=0)).mean() for steady in (False, True)]
    assert shaking[1] < 0.7 * shaking[0]


def test_a_restored_tracker_filters_as_before(walk_model: BasePoses, rng: np.random.Generator) -> None:
    people = detect_walk(walk_model, rng, 24)
    tracker = Tracker(walk_model, CONFIG)
    for i in range(16):
        tracker.update(i * STEP_NS, [people[i]], CAMERA)
    snapshot, twice = tracker.snapshot(), []
    for _ in range(2):
        tracker.restore(snapshot)
        found = [tracker.update(i * STEP_NS, [people[i]], CAMERA) for i in range(16, 24)]
        twice.append(np.array([person.joints for (person,) in found]))
    np.testing.assert_array_equal(twice[0], twice[1])


def test_a_prediction_goes_on_from_what_was_put_out(walk_model: BasePoses, rng: np.random.Generator) -> None:
    people = detect_walk(walk_model, rng, 30)
    tracker = Tracker(walk_model, CONFIG)
    for i, person in enumerate(people):
        (last,) = tracker.update(i * STEP_NS, [person], CAMERA)
    (predicted,) = tracker.update(30 * STEP_NS, [], CAMERA)
    assert predicted.predicted
    moved = predicted.joints - last.joints
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-9)
    assert np.linalg.norm(moved[0]) < 0.2
