"""Tests of the detection of swapped left and right."""

import numpy as np
import pytest

from mocap_ros.keypoints.association import measure_extent
from mocap_ros.keypoints.left_right import (
    INITIAL_SWAP_COST,
    MAX_VELOCITY_GAP_S,
    VELOCITY_TIME_S,
    SwapFilter,
    ViterbiPaths,
    compute_transition_cost,
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


def test_dropping_the_oldest_frames_keeps_the_later_decisions(walk: np.ndarray) -> None:
    is_swapped = np.isin(np.arange(FRAMES), [5, 40, 41])
    swap_filter = run_filter(SwapFilter(MIRROR), swap(walk, is_swapped))
    shortened = swap_filter.drop_oldest(30)
    assert shortened.is_swapped.tolist() == swap_filter.is_swapped[30:].tolist()
    assert shortened.paths is not None
    assert shortened.paths.is_swapped.shape == (2, FRAMES - 30)
    assert swap_filter.drop_oldest(0) is swap_filter


def test_velocities_are_smoothed_and_forgotten_after_a_gap() -> None:
    speed = np.array([300.0, -120.0])  # px/s
    seen = np.ones((2, 15), bool)

    def make_points(time_s: float) -> np.ndarray:
        return np.broadcast_to(speed * time_s, (2, 15, 2))

    paths = ViterbiPaths.initialise(0.0, make_points(0.0), seen)
    for frame in range(1, 4):
        time_s = frame / 30
        paths = paths.advance(time_s, make_points(time_s), seen, np.zeros(2), np.array([0, 1]))
        share = 1 - np.exp(-time_s / VELOCITY_TIME_S)
        assert paths.velocity == pytest.approx(np.broadcast_to(share * speed, (2, 15, 2)))
    after_short_gap, after_long_gap = (
        paths.advance(0.1 + gap_s, make_points(0.1 + gap_s), seen, np.zeros(2), np.array([0, 1]))
        for gap_s in (0.9 * MAX_VELOCITY_GAP_S, 1.1 * MAX_VELOCITY_GAP_S)
    )
    assert after_short_gap.velocity[0, 0] == pytest.approx(speed, rel=0.02)
    assert not after_long_gap.velocity.any()


def test_transition_probabilities_are_those_of_the_chain() -> None:
    step = np.exp(-compute_transition_cost(1 / 30))
    assert step == pytest.approx(np.array([[0.99, 0.01], [0.15, 0.85]]))
    assert np.exp(-compute_transition_cost(7 / 30)) == pytest.approx(np.linalg.matrix_power(step, 7))
