# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parts of the keyframe method: distances and selection follow the paper, the fit descends, outliers are found."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import KeyframesConfig
from mocap_ros.errors import InputError
from mocap_ros.offline.keyframes.alignment import AlignedMotion, align_motion
from mocap_ros.offline.keyframes.half_poses import (
    BodyHalf,
    HalfPoses,
    build_averaging_matrix,
    compute_distances,
    denoise_distances,
    split_into_halves,
)
from mocap_ros.offline.keyframes.image_points import (
    build_low_pass_matrix,
    find_outliers,
    interpolate_gaps,
    nan_median,
)
from mocap_ros.offline.keyframes.keyframe_set import (
    estimate_frame_interval,
    find_interpolatable,
    find_keyframe_set,
    select_keyframes,
)
from mocap_ros.offline.keyframes.motion import FitResult, fit_motion, slerp
from mocap_ros.offline.keyframes.taylor import parse_depth_choices, reconstruct_limbs
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import SolverStatus
from tests.support.swinging_body import BONE_LENGTHS, STANDING, make_swinging_body


def make_half_poses(points: np.ndarray, seen: np.ndarray | None = None) -> HalfPoses:
    frames = np.arange(len(points))
    seen = np.ones(points.shape[:2], bool) if seen is None else seen
    return HalfPoses(frames, frames / 30, points.astype('f4'), seen)


def test_distances_follow_the_formulas_of_sections_4_1_and_4_2(rng: np.random.Generator) -> None:
    points, seen = rng.normal(size=(9, 6, 2)), rng.random((9, 6)) < 0.7
    seen[:, :2] = True
    poses = make_half_poses(points, seen)
    c, _ = compute_distances(poses, poses)
    b, a = np.zeros((9, 9)), np.zeros((9, 9))
    for i in range(9):
        for j in range(9):
            both = seen[i] & seen[j]
            difference = points[i, both] - points[j, both]
            b[i, j] = np.linalg.norm(difference - difference.mean(axis=0), axis=-1).mean()
            a[i, j] = both.sum() / (seen[i] | seen[j]).sum()
    assert c == pytest.approx(a * b + (1 - a) * b.max(), abs=1e-5)
    beta = float(np.median(c))
    d = denoise_distances(c, build_averaging_matrix(c, beta))
    near = [np.flatnonzero((c[i] < beta) | (np.arange(9) == i)) for i in range(9)]
    expected = [[c[np.ix_(near[i], near[j])].mean() for j in range(9)] for i in range(9)]
    assert d == pytest.approx(np.array(expected), abs=1e-5)


def compute_selection_cost(well_represented: np.ndarray, times: np.ndarray) -> float:
    """Return C_K, s, by direct evaluation of equation 2, for the frames of W, `well_represented` (N,)."""
    step = estimate_frame_interval(times)
    total = 0.0
    for i, t in enumerate(times):
        left = times[:i][well_represented[:i]]
        right = times[i + 1 :][well_represented[i + 1 :]]
        total += t - (left[-1] if len(left) else times[0] - step)
        total += (right[0] if len(right) else times[-1] + step) - t
    return float(total)


def select_directly(represents: np.ndarray, times: np.ndarray, alpha: float, gap: float) -> list[int]:
    """Select keyframes by direct evaluation of equations 1 to 4."""
    represents = represents | np.eye(len(times), dtype=bool)
    keyframes: list[int] = []
    while True:
        well_represented = np.asarray(represents[np.array(keyframes, int)].any(axis=0))
        if (well_represented | find_interpolatable(well_represented, times, gap)).sum() >= alpha * len(times):
            return keyframes
        cost = [
            np.inf if k in keyframes else compute_selection_cost(well_represented | represents[k], times)
            for k in range(len(times))
        ]
        keyframes.append(int(np.argmax(np.array(cost) <= min(cost) + 1e-9 * max(min(cost), 1.0))))


@settings(max_examples=60)
@given(data=st.data())
def test_incremental_selection_equals_direct_selection(data: st.DataObject) -> None:
    frames = data.draw(st.integers(1, 24))
    seed, density = data.draw(st.integers(0, 10**6)), data.draw(st.sampled_from([0.0, 0.05, 0.2, 0.6]))
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([1.0, 1.0, 2.0, 7.0], frames)) / 32  # exact in binary: ties are ties
    represents = rng.random((frames, frames)) < density
    alpha = data.draw(st.sampled_from([0.0, 0.5, 0.9, 1.0]))
    gap = data.draw(st.sampled_from([0.0, 0.1, 0.3]))
    found = select_keyframes(represents, times, alpha, gap)
    assert found.tolist() == select_directly(represents, times, alpha, gap)


def test_sections_need_hardly_more_keyframes_than_one_matrix() -> None:
    poses, times = make_swinging_body(600)
    half = split_into_halves()[1]
    half_poses = make_half_poses(poses[:, list(half.joints), :2] / 0.5)
    half_poses = replace(half_poses, times=times)
    one_matrix = find_keyframe_set(half_poses, half, 600, KeyframesConfig(beta=0.03, max_matrix_frames=600))
    in_sections = find_keyframe_set(half_poses, half, 600, KeyframesConfig(beta=0.03, max_matrix_frames=150))
    assert len(in_sections.distance_matrix) == 150
    assert one_matrix.coverage >= 0.95
    assert in_sections.coverage >= 0.95
    assert len(one_matrix.frames) > 8
    assert len(in_sections.frames) <= 1.1 * len(one_matrix.frames)  # measured: 11 and 12
    assert (in_sections.distance[in_sections.frames] == 0).all()


def test_slerp_turns_at_constant_speed_and_holds_the_ends() -> None:
    a, b = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    out = slerp(np.stack([a, b])[:, None], np.array([1.0, 2.0]), np.array([0.0, 1.0, 1.2, 1.5, 2.0, 9.0]))[:, 0]
    angles = np.array([0.0, 0.0, 0.2, 0.5, 1.0, 1.0]) * np.pi / 2
    assert out == pytest.approx(np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]), abs=1e-5)
    opposite = slerp(np.stack([a, -a])[:, None], np.array([0.0, 1.0]), np.linspace(0, 1, 5))
    assert np.isfinite(opposite).all()


def test_the_fit_descends_and_keeps_limbs() -> None:
    poses, times = make_swinging_body(90)
    scale, shift = 200.0, np.array([30.0, -10.0])
    points = scale * poses[..., :2] + shift
    weight = np.ones(poses.shape[:2])
    stiff = np.repeat(STANDING[None], 90, axis=0)
    start = align_motion(stiff, points, weight, times, np.inf)
    assert start.scale == pytest.approx(scale, rel=0.15)

    def descend(iterations: int) -> FitResult:
        options: dict[str, Any] = {'focal': np.inf, 'step': 0.2, 'smoothing': 0.03, 'iterations': iterations}
        return fit_motion(start, points, weight, times, BONE_LENGTHS, CMU15, **options)

    fit = descend(40)
    error = start.joints[..., :2] - start.back_project(points, np.inf)
    error -= error.mean(axis=1, keepdims=True)
    assert fit.mean_squared_errors[0] == pytest.approx((error**2).sum(axis=-1).mean())
    assert (np.diff(fit.mean_squared_errors[:-1]) <= 0).all()
    assert fit.mean_squared_errors[-1] < 1.1 * 0.158 * fit.mean_squared_errors[0]  # measured: 0.158
    assert np.ptp(CMU15.bone_lengths(fit.motion.joints), axis=0).max() < 1e-9
    assert fit.status is SolverStatus.MAX_ITERATIONS
    converged = descend(1000)
    assert converged.status is SolverStatus.CONVERGED
    assert 40 < len(converged.mean_squared_errors) - 1 < 1000


def test_alignment_recovers_a_perspective_camera() -> None:
    poses, times = make_swinging_body(60)
    motion = AlignedMotion(poses, np.full(60, 300.0), np.tile([40.0, -20.0], (60, 1)))
    points, weight = motion.project(600.0), np.ones(poses.shape[:2])
    found = align_motion(poses, points, weight, times, 600.0)
    assert found.scale == pytest.approx(300.0, rel=1e-3)
    assert found.translation == pytest.approx(motion.translation, abs=0.2)
    assert found.joints == pytest.approx(poses, abs=1e-3)


def test_outliers_are_found_with_few_false_ones(rng: np.random.Generator) -> None:
    times = np.arange(300) / 30
    truth = 0.04 * np.sin(2 * np.pi * times / 1.5)[:, None, None] * rng.normal(size=(1, 15, 2))
    seen = rng.random((300, 15)) > 0.05
    displacement = truth + rng.normal(0, 0.012, (300, 15, 2))
    is_outlier = np.zeros((300, 15), bool)
    for _ in range(40):
        start, joint, length = rng.integers([0, 0, 1], [290, 15, 9])
        is_outlier[start : start + length, joint] = True
        angle = rng.uniform(0, 2 * np.pi)
        displacement[start : start + length, joint] += 0.4 * np.array([np.cos(angle), np.sin(angle)])
    found = find_outliers(displacement, seen, times)
    assert not (found & ~seen).any()
    assert found[is_outlier & seen].mean() > 0.92  # measured: 0.929
    assert not found[~is_outlier & seen].any()
    seen_late = np.zeros((300, 15), bool)
    seen_late[150:] = True
    assert find_outliers(truth, seen_late, times).sum() == 0


def test_short_gaps_are_interpolated_and_medians_ignore_nan() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.9])
    points = np.array([0.0, 9, 2, 9, 8])[:, None, None]
    out, known = interpolate_gaps(points, np.array([1, 0, 1, 0, 1], bool)[:, None], times, 0.3)
    assert known[:, 0].tolist() == [True, True, True, False, True]
    assert out[1, 0, 0] == pytest.approx(1.0)
    values = np.array([[np.nan, np.nan], [3.0, np.nan], [1.0, np.nan]])
    assert nan_median(values, axis=0) == pytest.approx([2.0, np.nan], nan_ok=True)
    assert build_low_pass_matrix(times, 0.1) @ np.ones(5) == pytest.approx(np.ones(5))


@pytest.mark.parametrize('half', split_into_halves(), ids=lambda half: half.name)
def test_taylors_method_recovers_a_pose(half: BodyHalf) -> None:
    poses, _ = make_swinging_body(40)
    pose = poses[17]
    lengths = np.array([np.linalg.norm(pose[c] - pose[p]) for p, c in half.bones])
    forward = frozenset(CMU15.joints[c] for p, c in half.bones if pose[c, 2] < pose[p, 2])
    limbs, scale = reconstruct_limbs(180.0 * pose[:, :2] + [50, 60], lengths, half.bones, forward, 180.0)
    assert limbs == pytest.approx(np.array([pose[c] - pose[p] for p, c in half.bones]), abs=1e-9)
    assert scale == 180.0
    flat = pose * [1, 1, 0]
    lengths = np.array([np.linalg.norm(flat[c] - flat[p]) for p, c in half.bones])
    min_scale = reconstruct_limbs(70.0 * flat[:, :2], lengths, half.bones, frozenset())[1]
    assert min_scale == pytest.approx(70.0)


def test_taylors_method_names_the_joint_that_it_refuses() -> None:
    half = split_into_halves()[0]
    lengths = np.full(len(half.bones), 0.3)
    points = 100.0 * STANDING[:, :2]
    with pytest.raises(InputError, match="no limb of this half ends in 'lknee'"):
        reconstruct_limbs(points, lengths, half.bones, frozenset({'lknee'}))
    with pytest.raises(InputError, match='scale: 1 px/m is too small for the limb to neck'):
        reconstruct_limbs(points, lengths, half.bones, frozenset(), 1.0)
    points[4] = np.nan
    with pytest.raises(InputError, match='lwrist is not seen'):
        reconstruct_limbs(points, lengths, half.bones, frozenset())


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
def test_malformed_depth_choices_are_refused(tree: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_depth_choices(tree, 'c.yaml')
