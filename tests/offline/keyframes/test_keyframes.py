# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parts of the keyframe method: distances and selection follow the paper, the fit descends, outliers are found."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocap_ros.config import KeyframesConfig, TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
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
    find_outliers,
)
from mocap_ros.offline.keyframes.keyframe_method import observe_shots
from mocap_ros.offline.keyframes.keyframe_set import (
    estimate_frame_interval,
    find_interpolatable,
    find_keyframe_set,
    select_keyframes,
)
from mocap_ros.offline.keyframes.motion import FitResult, fit_motion
from mocap_ros.offline.keyframes.shots import find_shots, split_into_sections
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


@settings(max_examples=40)
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


@pytest.mark.parametrize(
    ('forward', 'scale', 'hidden', 'message'),
    [({'lknee'}, None, 0, "'lknee'"), (set(), 1.0, 0, 'scale: 1 px/m .* neck'), (set(), None, 4, 'lwrist')],
)
def test_taylors_method_names_the_joint_that_it_refuses(
    forward: set[str], scale: float | None, hidden: int, message: str
) -> None:
    half = split_into_halves()[0]
    points = 100.0 * STANDING[:, :2]
    if hidden:
        points[hidden] = np.nan
    with pytest.raises(InputError, match=message):
        reconstruct_limbs(points, np.full(len(half.bones), 0.3), half.bones, frozenset(forward), scale)


GOOD_CHOICE = {'half': 'upper', 'time': 1, 'forward': []}


@pytest.mark.parametrize(
    ('tree', 'place'),
    [
        ([], 'c.yaml: '),
        ({'keyframes': [3]}, r'c.yaml: keyframes\[0\]: expected time'),
        ({'keyframes': [GOOD_CHOICE, {'colour': 1}]}, r"keyframes\[1\]: unknown 'colour'"),
        *(
            ({'keyframes': [GOOD_CHOICE | {name: value}]}, rf'keyframes\[0\].*{name}: ')
            for name, value in (('half', 'left'), ('time', 'x'), ('forward', 'lelbow'), ('scale', 0))
        ),
    ],
)
def test_malformed_depth_choices_are_refused(tree: object, place: str) -> None:
    with pytest.raises(InputError, match=place):
        parse_depth_choices(tree, 'c.yaml')


Array = NDArray[np.float64]

CAMERA = Intrinsics(900.0, (640.0, 360.0), is_focal_known=True)
MIRROR = list(CMU15.mirror)
FRAMES = 90


def make_rays(frames: int = FRAMES) -> tuple[Array, Array, Array]:
    """Return rays (F, 15, 2), weights (F, 15) and times (F,) s of a person who moves without a cut."""
    poses, times = make_swinging_body(frames)
    joints = poses + [0.2, 0.0, 4.0]
    return joints[..., :2] / joints[..., 2:], np.ones((frames, 15)), times


def list_starts(shots: list[slice]) -> list[int]:
    assert shots[-1].stop == FRAMES
    assert [s.stop for s in shots[:-1]] == [s.start for s in shots[1:]]
    return [s.start for s in shots]


@pytest.mark.parametrize('unit', [1.0, 900.0], ids=['rays', 'px'])
def test_a_jump_of_the_body_is_a_cut_and_swapped_sides_are_none(unit: float) -> None:
    rays, weight, times = make_rays()
    rays[20:24] = rays[20:24][:, MIRROR]
    rays[40, 3] += 0.5  # one joint is misplaced
    assert list_starts(find_shots(unit * rays, weight, times)) == [0]
    rays[50:] += 0.2
    assert list_starts(find_shots(unit * rays, weight, times)) == [0, 50]


def test_swapped_sides_are_put_right_in_each_shot() -> None:
    rays, weight, times = make_rays()
    rays[50:] += 0.2
    keypoints = np.concatenate([CAMERA.focal * rays + CAMERA.center, weight[..., None]], axis=-1)
    swapped = keypoints.copy()
    for frames in (slice(20, 24), slice(60, 63)):
        swapped[frames] = keypoints[frames][:, MIRROR]
    observed = observe_shots(swapped, CMU15.joints, times, CAMERA, TrackerConfig())
    assert observed.rays == pytest.approx(rays, abs=1e-9)


@pytest.mark.parametrize(('max_seconds', 'count'), [(60.0, 1), (1.0, 3), (0.5, 6)])
def test_sections_cover_each_frame_once_and_their_margins(max_seconds: float, count: int) -> None:
    times = np.arange(FRAMES) / 30
    sections = split_into_sections(times, max_seconds, margin=0.2)
    assert len(sections) == count
    assert np.concatenate([np.arange(FRAMES)[inner] for _, inner in sections]).tolist() == list(range(FRAMES))
    for padded, inner in sections:
        assert padded.start == max(inner.start - 6, 0)
        assert inner.stop <= padded.stop <= inner.stop + 6
