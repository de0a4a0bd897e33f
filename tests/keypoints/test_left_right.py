"""Tests of the detection of swapped left and right."""

import numpy as np
import pytest

from mocap_ros.keypoints.association import measure_extent
from mocap_ros.keypoints.left_right import (
    CAUCHY_SCALE,
    INITIAL_SWAP_COST,
    MAX_VELOCITY_GAP_S,
    MIN_STEP_S,
    PREDICTION_STD,
    PREDICTION_STD_PER_S,
    PREDICTION_STD_PER_S2,
    VELOCITY_GAIN,
    VELOCITY_TIME_S,
    SwapFilter,
    ViterbiPaths,
    compute_transition_cost,
    exchange_sides,
    find_swapped_frames,
)
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from tests.support.synthetic_walk import make_walk

MIRROR = np.array(CMU15.mirror)
FRAMES = 90
TIMES = np.arange(FRAMES) / 30
SEEN = np.ones((FRAMES, 15))


@pytest.fixture
def walk(walk_model: BasePoses, rng: np.random.Generator) -> np.ndarray:
    _, _, points, _ = make_walk(walk_model, frames=FRAMES)
    return points + rng.normal(0, 1.0, points.shape)


def swap(points: np.ndarray, frames: np.ndarray) -> np.ndarray:
    return np.where(frames[:, None, None], points[:, MIRROR], points)


def run_filter(swap_filter: SwapFilter, points: np.ndarray, weight: np.ndarray = SEEN) -> SwapFilter:
    for time_s, image, score in zip(TIMES, points, weight, strict=True):
        swap_filter = swap_filter.update(float(time_s), image, score, measure_extent(image, score).size)
    return swap_filter


def test_a_correct_sequence_has_no_swapped_frame(walk: np.ndarray) -> None:
    assert not find_swapped_frames(TIMES, walk, SEEN, MIRROR).any()


@pytest.mark.parametrize(('first', 'last'), [(20, 20), (30, 36), (50, 59), (80, 89)])
def test_an_injected_swap_of_the_whole_body_is_found(walk: np.ndarray, first: int, last: int) -> None:
    is_swapped = (np.arange(FRAMES) >= first) & (np.arange(FRAMES) <= last)
    found = find_swapped_frames(TIMES, swap(walk, is_swapped), SEEN, MIRROR)
    assert np.flatnonzero(found).tolist() == np.flatnonzero(is_swapped).tolist()


def test_undoing_the_found_swaps_restores_the_points(walk: np.ndarray) -> None:
    is_swapped = np.isin(np.arange(FRAMES), [10, 11, 40, 41, 42, 70])
    disturbed = swap(walk, is_swapped)
    found = find_swapped_frames(TIMES, disturbed, SEEN, MIRROR)
    assert (swap(disturbed, found) == walk).all()


def test_hidden_joints_and_empty_frames_do_not_hide_a_swap(walk: np.ndarray) -> None:
    weight = SEEN.copy()
    weight[:, [3, 4]] = 0
    weight[25] = 0
    is_swapped = np.isin(np.arange(FRAMES), [40, 41, 42])
    disturbed = swap(walk, is_swapped)
    weight = np.where(is_swapped[:, None], weight[:, MIRROR], weight)
    found = find_swapped_frames(TIMES, disturbed, weight, MIRROR)
    assert (found == is_swapped).all()


def test_a_swapped_first_frame_is_corrected_by_later_frames(walk: np.ndarray) -> None:
    is_swapped = np.arange(FRAMES) < 2
    swap_filter = SwapFilter(MIRROR)
    disturbed = swap(walk, is_swapped)
    first = swap_filter.update(0.0, disturbed[0], SEEN[0], measure_extent(disturbed[0], SEEN[0]).size)
    assert first.paths is not None
    assert first.paths.cost.tolist() == [0.0, INITIAL_SWAP_COST]
    assert first.is_swapped.tolist() == [False]
    found = run_filter(swap_filter, disturbed).is_swapped
    assert (found == is_swapped).all()


def test_a_disabled_filter_believes_the_detector(walk: np.ndarray) -> None:
    is_swapped = np.isin(np.arange(FRAMES), [20, 21, 22])
    disabled = run_filter(SwapFilter(MIRROR, enabled=False), swap(walk, is_swapped))
    assert disabled.is_swapped.shape == (FRAMES,)
    assert not disabled.is_swapped.any()
    assert disabled.paths is None
    assert run_filter(SwapFilter(MIRROR), swap(walk, is_swapped)).is_swapped.sum() == 3


@pytest.mark.parametrize('enabled', [True, False])
def test_frames_that_are_dropped_leave_the_decisions_about_later_ones(walk: np.ndarray, enabled: bool) -> None:
    before = run_filter(SwapFilter(MIRROR, enabled), swap(walk, np.isin(np.arange(FRAMES), [5, 40, 41])))
    newest = (FRAMES / 30, walk[-1], SEEN[-1], 60.0)
    whole, shortened = before.update(*newest), before.update(*newest, dropped=30)
    assert whole.is_swapped.shape == (FRAMES + 1,)
    assert whole.is_swapped[40] == enabled
    assert shortened.is_swapped.tolist() == whole.is_swapped[30:].tolist()
    if enabled:
        assert whole.paths is not None
        assert shortened.paths is not None
        np.testing.assert_array_equal(shortened.paths.is_swapped, whole.paths.is_swapped[:, 30:])
        np.testing.assert_array_equal(shortened.paths.cost, whole.paths.cost)
    assert before.update(*newest, dropped=FRAMES).is_swapped.shape == (1,)


def step_plainly(
    paths: ViterbiPaths, time_s: float, points: np.ndarray, weight: np.ndarray, body_size: float
) -> ViterbiPaths:
    """Continue the paths by a frame, by the formulas of the module."""
    points, seen = np.stack([points, points[MIRROR]]), np.stack([weight, weight[MIRROR]]) > 0
    age = time_s - paths.last_seen_s
    horizon = VELOCITY_GAIN * VELOCITY_TIME_S * (1 - np.exp(-age / VELOCITY_TIME_S))
    with np.errstate(invalid='ignore'):
        predicted = paths.points + horizon[..., None] * paths.velocity
        sigma = PREDICTION_STD + PREDICTION_STD_PER_S * age + PREDICTION_STD_PER_S2 * age**2
        error = np.linalg.norm(points - predicted[:, None], axis=-1) / (sigma * body_size)[:, None]
        loss = CAUCHY_SCALE * np.log(1 + error**2 / (2 * CAUCHY_SCALE)) + 2 * np.log(sigma)[:, None]
    counted = seen & (np.isfinite(age) & (np.arange(15) != MIRROR))[:, None]
    likelihood_cost = np.where(counted, loss, 0).sum(axis=-1)
    elapsed_s = time_s - paths.last_seen_s[0].max()
    total = paths.cost[:, None] + likelihood_cost + compute_transition_cost(elapsed_s)
    predecessor = total.argmin(axis=0)
    cost, age = total.min(axis=0), np.maximum(age[predecessor], MIN_STEP_S)
    old_points, old_velocity = paths.points[predecessor], paths.velocity[predecessor]
    blend = 1 - np.exp(-age / VELOCITY_TIME_S)
    velocity = old_velocity + blend[..., None] * ((points - old_points) / age[..., None] - old_velocity)
    velocity[age >= MAX_VELOCITY_GAP_S] = 0
    return ViterbiPaths(
        cost - cost.min(),
        np.append(paths.is_swapped[predecessor], [[False], [True]], axis=1),
        np.where(seen[..., None], points, old_points),
        np.where(seen[..., None], velocity, old_velocity),
        np.where(seen, time_s, paths.last_seen_s[predecessor]),
    )


def test_the_compiled_steps_are_those_of_the_formulas(walk: np.ndarray, rng: np.random.Generator) -> None:
    weight = rng.random(SEEN.shape) * (rng.random(SEEN.shape) > 0.2)
    weight[:30, 3] = 0  # a joint that is first seen in frame 30
    times = np.cumsum(rng.choice([1 / 30, 1 / 15, 0.3], FRAMES, p=[0.8, 0.1, 0.1]))
    points = swap(walk, rng.random(FRAMES) < 0.3)
    swap_filter = SwapFilter(MIRROR).update(float(times[0]), points[0], weight[0], 60.0)
    predecessors = set()
    for frame in range(1, FRAMES):
        before = swap_filter.paths
        assert before is not None
        swap_filter = swap_filter.update(float(times[frame]), points[frame], weight[frame], 60.0)
        found, expected = swap_filter.paths, step_plainly(before, times[frame], points[frame], weight[frame], 60.0)
        assert found is not None
        for name in ('cost', 'points', 'velocity', 'last_seen_s'):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), 1e-9, 1e-9, err_msg=name)
        np.testing.assert_array_equal(found.is_swapped, expected.is_swapped)
        np.testing.assert_array_equal(swap_filter.is_swapped, expected.is_swapped[expected.cost.argmin()])
        predecessors |= {(bool(s[-2]), bool(s[-1])) for s in found.is_swapped}
    assert predecessors == {(False, False), (False, True), (True, False), (True, True)}


def test_velocities_are_smoothed_and_forgotten_after_a_gap() -> None:
    speed = np.array([300.0, -120.0])  # px/s
    image = np.stack([np.linspace(0, 50, 15), np.linspace(0, 200, 15)], axis=1)

    def move(swap_filter: SwapFilter, time_s: float) -> SwapFilter:
        return swap_filter.update(time_s, image + speed * time_s, np.ones(15), 60.0)

    swap_filter, share = move(SwapFilter(MIRROR), 0.0), 0.0
    for frame in range(1, 4):
        swap_filter = move(swap_filter, frame / 30)
        share += (1 - np.exp(-1 / 30 / VELOCITY_TIME_S)) * (1 - share)
        assert swap_filter.paths is not None
        assert swap_filter.paths.velocity[0] == pytest.approx(np.broadcast_to(share * speed, (15, 2)))
    after_short_gap, after_long_gap = (
        move(swap_filter, 0.1 + gap_s).paths for gap_s in (0.9 * MAX_VELOCITY_GAP_S, 1.1 * MAX_VELOCITY_GAP_S)
    )
    assert after_short_gap is not None
    assert after_long_gap is not None
    assert after_short_gap.velocity[0, 0] == pytest.approx(speed, rel=0.02)
    assert not after_long_gap.velocity.any()


def test_sides_are_exchanged_in_the_chosen_frames_only(walk: np.ndarray, rng: np.random.Generator) -> None:
    is_swapped, weight = rng.random(FRAMES) < 0.3, rng.random(SEEN.shape)
    points, exchanged = exchange_sides(walk, weight, is_swapped, MIRROR)
    np.testing.assert_array_equal(points, swap(walk, is_swapped))
    np.testing.assert_array_equal(exchanged, np.where(is_swapped[:, None], weight[:, MIRROR], weight))
    assert exchange_sides(walk, weight, np.zeros(FRAMES, bool), MIRROR) == (walk, weight)


def test_transition_probabilities_are_those_of_the_chain() -> None:
    step = np.exp(-compute_transition_cost(1 / 30))
    assert step == pytest.approx(np.array([[0.99, 0.01], [0.15, 0.85]]))
    assert np.exp(-compute_transition_cost(7 / 30)) == pytest.approx(np.linalg.matrix_power(step, 7))
