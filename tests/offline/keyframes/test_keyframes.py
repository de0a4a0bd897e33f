"""Keyframes: the choice is the paper's, step by step; the fit descends; wrong points are found."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import KeyframesConfig
from mocap_ros.errors import InputError
from mocap_ros.offline.keyframes.body_halves import HalfPoses, halves
from mocap_ros.offline.keyframes.distance import averaging, denoised, distances
from mocap_ros.offline.keyframes.filters import bridged, low_pass, median
from mocap_ros.offline.keyframes.gradient_fit import Placed, fitted, placed
from mocap_ros.offline.keyframes.interpolation import slerp, thinned
from mocap_ros.offline.keyframes.keyframe_set import summarised
from mocap_ros.offline.keyframes.outliers import outliers
from mocap_ros.offline.keyframes.selection import interpolatable, mean_gap_cost, select
from mocap_ros.offline.keyframes.taylor import choices_from, taylor_pose
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from tests.support.swinging_body import LENGTHS, STANDING, swinging


def flat_poses(points: np.ndarray, seen: np.ndarray | None = None) -> HalfPoses:
    frames = np.arange(len(points))
    seen = np.ones(points.shape[:2], bool) if seen is None else seen
    return HalfPoses(frames, frames / 30, points.astype('f4'), seen)


def test_distances_are_those_of_the_formula(rng) -> None:
    points, seen = rng.normal(size=(9, 6, 2)), rng.random((9, 6)) < 0.7
    seen[:, :2] = True
    poses = flat_poses(points, seen)
    c, _ = distances(poses, poses)
    b, a = np.zeros((9, 9)), np.zeros((9, 9))
    for i in range(9):
        for j in range(9):
            both = seen[i] & seen[j]
            difference = points[i, both] - points[j, both]
            b[i, j] = np.linalg.norm(difference - difference.mean(axis=0), axis=-1).mean()
            a[i, j] = both.sum() / (seen[i] | seen[j]).sum()
    assert c == pytest.approx(a * b + (1 - a) * b.max(), abs=1e-5)
    beta = float(np.median(c))
    d = denoised(c, averaging(c, beta))
    near = [np.flatnonzero((c[i] < beta) | (np.arange(9) == i)) for i in range(9)]
    expected = [[c[np.ix_(near[i], near[j])].mean() for j in range(9)] for i in range(9)]
    assert d == pytest.approx(np.array(expected), abs=1e-5)


def direct(represents: np.ndarray, times: np.ndarray, alpha: float, gap: float) -> list[int]:
    """Equations 1 to 4 as they stand."""
    represents = represents | np.eye(len(times), dtype=bool)
    chosen: list[int] = []
    while True:
        well = represents[chosen].any(axis=0) if chosen else np.zeros(len(times), bool)
        if (well | interpolatable(well, times, gap)).sum() >= alpha * len(times):
            return chosen
        cost = [np.inf if k in chosen else mean_gap_cost(well | represents[k], times) for k in range(len(times))]
        chosen.append(int(np.argmax(np.array(cost) <= min(cost) + 1e-9 * max(min(cost), 1.0))))


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_the_incremental_choice_is_the_direct_one(data) -> None:
    frames = data.draw(st.integers(1, 24))
    seed, density = data.draw(st.integers(0, 10**6)), data.draw(st.sampled_from([0.0, 0.05, 0.2, 0.6]))
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([1.0, 1.0, 2.0, 7.0], frames)) / 32  # exact in binary: ties are ties
    represents = rng.random((frames, frames)) < density
    alpha = data.draw(st.sampled_from([0.0, 0.5, 0.9, 1.0]))
    gap = data.draw(st.sampled_from([0.0, 0.1, 0.3]))
    found = select(represents, times, alpha, gap)
    assert found.keyframes.tolist() == direct(represents, times, alpha, gap)
    assert found.covered.mean() >= alpha


def test_interpolatable_frames_lie_between_well_represented_ones_less_than_the_gap_apart() -> None:
    well = np.array([0, 1, 0, 0, 1, 0, 0, 0, 1, 0], bool)
    assert np.flatnonzero(interpolatable(well, np.arange(10.0), 3.5)).tolist() == [2, 3]


def test_a_long_sequence_needs_hardly_more_keyframes_in_sections() -> None:
    poses, times = swinging(600)
    half = halves()[1]
    own = flat_poses(poses[:, list(half.joints), :2] / 0.5)
    own = replace(own, times=times)
    whole = summarised(own, half, 600, KeyframesConfig(beta=0.1, max_matrix_frames=600))
    parts = summarised(own, half, 600, KeyframesConfig(beta=0.1, max_matrix_frames=150))
    assert len(parts.matrix) == 150
    assert whole.coverage >= 0.95
    assert parts.coverage >= 0.95
    assert len(parts.frames) <= 1.5 * len(whole.frames)
    assert (parts.distance[parts.frames] == 0).all()


def test_control_points_thin_out_by_fit_and_stay_near() -> None:
    times = np.arange(30) / 30
    keyframe = np.repeat([0, 1, -1, 1], [12, 8, 4, 6])
    misfit = np.abs(np.arange(30) - 5.0)
    kept = thinned(keyframe, misfit, times, 0.2)
    assert 5 in kept
    gaps = np.diff(times[kept])
    assert (gaps <= 0.2 + 1e-9).all()
    assert len(kept) < 12
    assert (keyframe[kept] >= 0).all()


def test_slerp_turns_at_constant_speed_and_holds_the_ends() -> None:
    a, b = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    out = slerp(np.stack([a, b])[:, None], np.array([1.0, 2.0]), np.array([0.0, 1.0, 1.5, 2.0, 9.0]))[:, 0]
    half = np.sqrt(0.5)
    assert out == pytest.approx(np.array([a, a, [half, half, 0], b, b]), abs=1e-5)
    opposite = slerp(np.stack([a, -a])[:, None], np.array([0.0, 1.0]), np.linspace(0, 1, 5))
    assert np.isfinite(opposite).all()


def test_the_fit_descends_and_keeps_limbs() -> None:
    poses, times = swinging(90)
    scale, shift = 200.0, np.array([30.0, -10.0])
    points = scale * poses[..., :2] + shift
    weight = np.ones(poses.shape[:2])
    stiff = np.repeat(STANDING[None], 90, axis=0)
    start = placed(stiff, points, weight, times, np.inf)
    assert start.scale == pytest.approx(scale, rel=0.15)
    done = fitted(
        start, points, weight, times, LENGTHS, CMU15, focal=np.inf, step=0.2, smoothing=0.03, iterations=40
    )
    assert (np.diff(done.error[:-1]) <= 0).all()
    assert done.error[-1] < 0.25 * done.error[0]
    assert np.ptp(CMU15.bone_lengths(done.placed.joints), axis=0).max() < 1e-9


def test_true_perspective_is_undone() -> None:
    poses, times = swinging(60)
    here = Placed(poses, np.full(60, 300.0), np.tile([40.0, -20.0], (60, 1)))
    points, weight = here.image(600.0), np.ones(poses.shape[:2])
    found = placed(poses, points, weight, times, 600.0)
    assert found.scale == pytest.approx(300.0, rel=1e-3)
    assert found.translation == pytest.approx(here.translation, abs=0.2)
    assert found.joints == pytest.approx(poses, abs=1e-3)


def test_outliers_are_found_and_little_else(rng) -> None:
    times = np.arange(300) / 30
    truth = 0.04 * np.sin(2 * np.pi * times / 1.5)[:, None, None] * rng.normal(size=(1, 15, 2))
    seen = rng.random((300, 15)) > 0.05
    away = truth + rng.normal(0, 0.012, (300, 15, 2))
    wrong = np.zeros((300, 15), bool)
    for _ in range(40):
        start, joint, length = rng.integers([0, 0, 1], [290, 15, 9])
        wrong[start : start + length, joint] = True
        angle = rng.uniform(0, 2 * np.pi)
        away[start : start + length, joint] += 0.4 * np.array([np.cos(angle), np.sin(angle)])
    found = outliers(away, seen, times)
    assert not (found & ~seen).any()
    assert found[wrong & seen].mean() > 0.9
    assert found[~wrong & seen].mean() < 0.01
    late = np.zeros((300, 15), bool)
    late[150:] = True
    assert outliers(truth, late, times).sum() == 0


def test_short_gaps_are_bridged_and_medians_ignore_what_is_missing() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.9])
    points = np.array([0.0, 9, 2, 9, 8])[:, None, None]
    out, known = bridged(points, np.array([1, 0, 1, 0, 1], bool)[:, None], times, 0.3)
    assert known[:, 0].tolist() == [True, True, True, False, True]
    assert out[1, 0, 0] == pytest.approx(1.0)
    values = np.array([[np.nan, np.nan], [3.0, np.nan], [1.0, np.nan]])
    assert median(values, axis=0) == pytest.approx([2.0, np.nan], nan_ok=True)
    assert low_pass(times, 0.1) @ np.ones(5) == pytest.approx(np.ones(5))


@pytest.mark.parametrize('half', halves(), ids=lambda half: half.name)
def test_taylors_method_recovers_a_pose(half) -> None:
    poses, _ = swinging(40)
    pose = poses[17]
    lengths = np.array([np.linalg.norm(pose[c] - pose[p]) for p, c in half.bones])
    forward = frozenset(CMU15.joints[c] for p, c in half.bones if pose[c, 2] < pose[p, 2])
    limbs, scale = taylor_pose(180.0 * pose[:, :2] + [50, 60], lengths, half.bones, forward, 180.0)
    assert limbs == pytest.approx(np.array([pose[c] - pose[p] for p, c in half.bones]), abs=1e-9)
    assert scale == 180.0
    flat = pose * [1, 1, 0]
    lengths = np.array([np.linalg.norm(flat[c] - flat[p]) for p, c in half.bones])
    least = taylor_pose(70.0 * flat[:, :2], lengths, half.bones, frozenset())[1]
    assert least == pytest.approx(70.0)


def test_taylors_method_says_what_it_cannot_do() -> None:
    half = halves()[0]
    lengths = np.full(len(half.bones), 0.3)
    points = 100.0 * STANDING[:, :2]
    with pytest.raises(InputError, match="no limb ends in 'lknee'"):
        taylor_pose(points, lengths, half.bones, frozenset({'lknee'}))
    with pytest.raises(InputError, match='scale: 1 px/m is too small for neck'):
        taylor_pose(points, lengths, half.bones, frozenset(), 1.0)
    points[4] = np.nan
    with pytest.raises(InputError, match='lwrist is not seen'):
        taylor_pose(points, lengths, half.bones, frozenset())


@pytest.mark.parametrize(
    ('tree', 'message'),
    [
        ([], 'c.yaml: expected a list named keyframes'),
        ({'keyframes': [3]}, r'c.yaml: keyframes\[0\]: expected time'),
        ({'keyframes': [{'colour': 1}]}, r"keyframes\[0\]: unknown 'colour'"),
        ({'keyframes': [{'half': 'left', 'time': 1, 'forward': []}]}, 'half: expected upper or lower'),
        ({'keyframes': [{'half': 'upper', 'time': 'x', 'forward': []}]}, 'time: expected a number'),
        ({'keyframes': [{'half': 'upper', 'time': 1, 'forward': 'lelbow'}]}, 'forward: expected a list'),
        ({'keyframes': [{'half': 'upper', 'time': 1, 'forward': [], 'scale': 0}]}, 'scale: expected a number'),
    ],
)
def test_choices_that_are_none(tree: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        choices_from(tree, 'c.yaml')


def test_a_remembered_pose_is_recalled_and_the_memory_is_bounded() -> None:
    poses, _ = swinging(200)
    weight = np.ones(15)

    def image(pose: np.ndarray) -> np.ndarray:
        return 150.0 * pose[:, :2] + [300, 200]

    empty = KeyPoseMemory(beta=0.02, capacity=4)
    assert empty.recall(image(poses[0]), weight) is None
    memory = empty
    for pose in poses[:100:10]:
        memory = memory.remember(image(pose), weight, pose)
    assert len(empty.poses) == 0
    assert len(memory.poses) == 4
    known = poses[90]
    partly = weight.copy()
    partly[4] = 0
    seen = 2.0 * image(known) - 70
    seen[4] = np.nan
    found = replace(memory, beta=0.2).recall(np.nan_to_num(seen), partly)
    assert found is not None
    assert found.pose == pytest.approx(known - known.mean(axis=0))
    assert found.scale == pytest.approx(300.0)
    again = found.scale * found.pose[:, :2] + found.translation
    assert again[partly > 0] == pytest.approx(seen[partly > 0])
    assert memory.recall(image(poses[90] * [1, 0.4, 1]), weight) is None
    assert memory.remember(image(known), weight, known).poses[:3] == memory.poses[:3]
    few = np.zeros(15)
    few[:3] = 1
    assert memory.recall(image(known), few) is None
    with pytest.raises(InputError, match='do not fit'):
        memory.remember(image(known), weight, known[:3])
