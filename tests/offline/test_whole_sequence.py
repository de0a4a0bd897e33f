# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whole sequences: the most probable base poses, cameras, the learned prior, and points that are not explained;
the keyframe method: its parts follow the paper, from 2D to 3D, and on the command line with real files."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.arrays import Array
from mocap_ros.bags.reader import is_bag
from mocap_ros.cli.main import main
from mocap_ros.config import Config, TrackerConfig, with_settings
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_pose_models, load_base_poses, load_shipped_lifter
from mocap_ros.offline import whole_sequence
from mocap_ros.offline.keyframes import half_poses
from mocap_ros.offline.keyframes.alignment import AlignedMotion, align_motion
from mocap_ros.offline.keyframes.half_poses import BodyHalf, HalfPoses, split_into_halves
from mocap_ros.offline.keyframes.image_points import find_outliers
from mocap_ros.offline.keyframes.keyframe_method import observe_shots, reconstruct
from mocap_ros.offline.keyframes.keyframe_set import estimate_frame_interval, find_interpolatable, select_keyframes
from mocap_ros.offline.keyframes.motion import FitResult, fit_motion
from mocap_ros.offline.keyframes.shots import find_shots, split_into_sections
from mocap_ros.offline.keyframes.taylor import parse_depth_choices, reconstruct_limbs
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, estimate_stature
from mocap_ros.solvers.observed_window import observe_sequence
from mocap_ros.solvers.window import Reconstruction, SolverStatus
from tests.support.bodies import BONE_LENGTHS, STANDING, make_swinging_body
from tests.support.synthetic_walk import make_sequence, make_walk, mpjpe_mm, with_scores
from tests.support.whole_sequence import reconstruct_sequence

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
CONFIG = with_settings(Config(), {'solver.components': 12, 'solver.prior': 'pca'})


def test_the_most_probable_of_several_models_is_used() -> None:
    models = {name: load_base_poses(name) for name in ('walk', 'jump', 'all')}
    walk = make_walk(models['walk'])
    given = make_sequence(with_scores(walk.points), walk.times, CAMERA)
    several = reconstruct_sequence(given, models, CONFIG)
    assert several.base_poses == 'walk'
    alone = reconstruct_sequence(given, models['walk'], CONFIG)
    assert (alone.joints == several.joints).all()
    assert alone.core[..., 2].mean() > 1
    assert estimate_stature(alone.joints, CMU15) == pytest.approx(CONFIG.tracker.body_height, rel=1e-3)
    alternating = with_settings(CONFIG, {'solver.method': 'alternation'})
    one, other = (reconstruct_sequence(given, m, alternating).joints for m in (models, models['walk']))
    assert (one == other).all()
    assert not np.allclose(one, several.joints, atol=1e-6)


@pytest.mark.parametrize('method', ['whole', 'keyframes'])
def test_the_result_knows_its_cameras(walk_model: PoseModel, method: str) -> None:
    poses, times = make_swinging_body(45)
    truth = poses + [1.5, 0.2, 4.0]
    given = make_sequence(with_scores(CAMERA.project(truth)), times, CAMERA)
    if method == 'keyframes':
        result = reconstruct(given, {'walk': walk_model}, CONFIG).solved.poses
    else:
        result = reconstruct_sequence(given, walk_model, CONFIG)
    roots = result.core.mean(axis=1)
    assert result.translation == pytest.approx(CAMERA.project(roots), abs=1e-9)
    assert result.scale == pytest.approx(CAMERA.focal / roots[:, 2])
    mean = np.broadcast_to(walk_model.mean, poses.shape)
    along = np.einsum('tij,tkj->tki', result.rotation, mean)  # the mean pose, as the camera sees it
    turn = fit_rotation(along, centre_poses(result.core))
    assert np.trace(turn, axis1=1, axis2=2).min() > 1 + 2 * np.cos(np.radians(10))


def test_where_no_person_is_no_joint_was_seen(walk_model: PoseModel) -> None:
    _, _, points, times = make_walk(walk_model)
    anchors = [CMU15.index(side + joint) for joint in ('ankle', 'wrist') for side in 'lr']
    toes_heels_hands = points[:, [*anchors[:2], *anchors]] + 3.0  # px
    body = np.concatenate([points, toes_heels_hands, np.repeat(points[:, :1], 5, axis=1)], axis=1)
    keypoints = with_scores(body)
    keypoints[:3, :CORE_COUNT, 2] = 0  # face, feet and hands alone
    keypoints[20] = 100, 100, 1  # all at one position
    result = reconstruct_sequence(make_sequence(keypoints, times, CAMERA, BODY26.joints), walk_model, CONFIG)
    assert np.flatnonzero(np.isnan(result.joints).any(axis=(1, 2))).tolist() == [0, 1, 2]
    assert np.flatnonzero(result.inferred.all(axis=1)).tolist() == [0, 1, 2, 20]
    assert not result.inferred[3].any()
    assert np.isnan(result.joint_orientation[:3]).all()
    assert result.turn_inferred[:3].all()
    assert not result.turn_inferred[3:].all()


def test_the_learned_prior_is_better_than_the_base_poses_alone() -> None:
    walk_model = load_base_poses('walk')
    walk = make_walk(walk_model, frames=45)
    truth, points = walk.poses(walk_model), walk.points + np.random.default_rng(0).normal(size=walk.points.shape)
    unknown = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scene is orthographic
    models, given = load_base_pose_models('auto'), make_sequence(with_scores(points), walk.times, unknown)
    both, alone = (
        reconstruct_sequence(given, m, with_settings(Config(), {'solver.prior': p}))
        for m, p in ((models, 'learned'), (models['all'], 'pca'))
    )
    assert both.base_poses == 'all'
    network = load_shipped_lifter().lift_sequence(points, np.ones(points.shape[:2]), walk.times).select_core()
    error = mpjpe_mm(both.core, truth)
    assert error < 1.1 * 24.3  # mm, measured; the base poses alone: 26.8, the network alone: 19.2
    assert error < mpjpe_mm(alone.core, truth)
    assert error < 1.35 * mpjpe_mm(network.joints, truth)


def test_points_are_drawn_to_where_the_solution_has_them(rng: np.random.Generator) -> None:
    body, times = make_swinging_body(30)
    joints = centre_poses(body) + [0.8, 0.2, 4.0]
    exact = CAMERA.project(joints)
    noisy = exact + rng.normal(0, 3, exact.shape)
    noisy[4, 11] += 200.0  # a point that is somewhere else
    keypoints = with_scores(noisy)
    keypoints[7, 3, 2] = 0.0
    observed = observe_sequence(make_sequence(keypoints, times, CAMERA), Config().tracker)
    camera, roots = observed.virtual_camera, joints.mean(axis=1)
    cameras = camera.weak_perspective_cameras(np.tile(np.eye(3), (30, 1, 1)), roots)
    in_virtual = camera.to_virtual_camera(joints)
    middle = in_virtual.mean(axis=1)
    truth = Reconstruction(
        joints=centre_poses(in_virtual),
        theta=np.zeros((30, 1)),
        cameras=cameras,
        translation=CAMERA.focal * middle[:, :2] / middle[:, 2:],
        residual=np.zeros(30),
        status=SolverStatus.CONVERGED,
        history=(0.0,),
        iterations=1,
    )
    believed = whole_sequence.hide_unexplained_points(observed, observed.build_solver_window(), truth)
    corrected = whole_sequence.draw_points(believed, truth)
    is_hidden = observed.weight != corrected.weight
    assert np.argwhere(is_hidden).tolist() == [[4, 11]]
    seen = corrected.weight > 0
    before, after = ((r - joints[..., :2] / joints[..., 2:])[seen] for r in (observed.rays, corrected.rays))
    np.testing.assert_allclose(after, whole_sequence.SEEN_SHARE * before, atol=1e-9)


def test_unexplained_points_stand_out_from_the_other_errors_of_the_sequence() -> None:
    error = np.random.default_rng(0).uniform(0.02, 0.06, (20, 15))
    seen = np.ones(error.shape, bool)
    error[3:9, 4], error[7, 6], error[12, 2] = 0.3, 0.19, 0.3
    error[15, :3] = 0.3  # so many joints: the solution is wrong
    seen[12, 2] = False
    found = whole_sequence.find_unexplained_points(error, seen)
    assert set(zip(*np.nonzero(found), strict=True)) == {(frame, 4) for frame in range(3, 9)} | {(7, 6)}
    assert not whole_sequence.find_unexplained_points(error / 5, seen).any(), 'precise points are believed'


def test_distances_follow_the_formulas_of_sections_4_1_and_4_2(rng: np.random.Generator) -> None:
    points, seen = rng.normal(size=(9, 6, 2)), rng.random((9, 6)) < 0.7
    seen[:, :2] = True
    poses = HalfPoses(np.arange(9), np.arange(9) / 30, points.astype('f4'), seen)
    c, _ = half_poses.compute_distances(poses, poses)
    b, a = np.zeros((9, 9)), np.zeros((9, 9))
    for i in range(9):
        for j in range(9):
            both = seen[i] & seen[j]
            difference = points[i, both] - points[j, both]
            b[i, j] = np.linalg.norm(difference - difference.mean(axis=0), axis=-1).mean()
            a[i, j] = both.sum() / (seen[i] | seen[j]).sum()
    assert c == pytest.approx(a * b + (1 - a) * b.max(), abs=1e-5)
    beta = float(np.median(c))
    d = half_poses.denoise_distances(c, half_poses.build_averaging_matrix(c, beta))
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
def test_taylors_method_names_the_joint(forward: set[str], scale: float | None, hidden: int, message: str) -> None:
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


SHOT_CAMERA = Intrinsics(900.0, (640.0, 360.0), is_focal_known=True)
MIRROR = list(CMU15.mirror)
FRAMES = 90


def make_rays() -> tuple[Array, Array, Array]:
    """Return rays (F, 15, 2), weights (F, 15) and times (F,) s of a person who moves without a cut."""
    poses, times = make_swinging_body(FRAMES)
    joints = poses + [0.2, 0.0, 4.0]
    return joints[..., :2] / joints[..., 2:], np.ones((FRAMES, 15)), times


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
    rays, _, times = make_rays()
    rays[50:] += 0.2
    keypoints = with_scores(SHOT_CAMERA.focal * rays + SHOT_CAMERA.center)
    swapped = keypoints.copy()
    for frames in (slice(20, 24), slice(60, 63)):
        swapped[frames] = keypoints[frames][:, MIRROR]
    observed = observe_shots(make_sequence(swapped, times, SHOT_CAMERA), TrackerConfig())
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


LIFTER_CONFIG = with_settings(Config(), {'keyframes.poses': 'lifter'})
MODELS = load_base_pose_models('all')


def make_wide_walk(frames: int = 240) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keypoints (F, 15, 3), times (F,) and truth (F, 15, 3) m in the camera's frame."""
    poses, times = make_swinging_body(frames)
    c, s = np.cos(0.9), np.sin(0.9)
    poses = poses @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    position = np.stack([0.5 * np.sin(0.6 * times), 0 * times, 4 + 0.5 * np.cos(0.6 * times)], axis=-1)
    truth = poses + position[:, None]
    return with_scores(SHOT_CAMERA.project(truth)), times, truth


def test_a_projected_motion_is_reconstructed_with_and_without_outliers() -> None:
    keypoints, times, truth = make_wide_walk()
    clean = reconstruct(make_sequence(keypoints, times, SHOT_CAMERA), MODELS, LIFTER_CONFIG)
    assert mpjpe_mm(clean.solved.poses.joints, truth) < 1.1 * 58.5  # mm, measured
    distance = np.linalg.norm(clean.solved.poses.joints.mean(axis=1) - truth.mean(axis=1), axis=-1)
    assert distance.mean() < 1.1 * 0.0852  # m, measured
    reprojection_error = np.linalg.norm(
        SHOT_CAMERA.project(clean.solved.poses.joints) - keypoints[..., :2], axis=-1
    )
    assert reprojection_error.max() < 1.1 * 23.5  # px, measured
    assert np.ptp(CMU15.bone_lengths(clean.solved.poses.joints), axis=0).max() < 1e-6
    assert not clean.outliers.any()

    rng = np.random.default_rng(1)
    wrong = rng.random(keypoints.shape[:2]) < 0.04
    corrupted = keypoints.copy()
    corrupted[wrong, :2] += 100 * np.sign(rng.normal(size=(wrong.sum(), 2)))
    corrupted[100:112] = [np.nan, np.nan, 0]
    wrong[100:112] = False
    found = reconstruct(make_sequence(corrupted, times, SHOT_CAMERA), MODELS, LIFTER_CONFIG)
    assert (found.outliers == wrong).all()
    assert found.solved.poses.inferred[found.outliers].all()
    assert mpjpe_mm(found.solved.poses.joints, truth) < 1.1 * 60.3  # mm, measured


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('case', ['one frame', 'still', 'no legs', 'two frames seen', 'a last frame much later'])
def test_degenerate_keypoints(case: str) -> None:
    keypoints, times, _ = make_wide_walk(1 if case == 'one frame' else 60)
    if case == 'still':
        keypoints[:] = keypoints[0]
    elif case == 'no legs':
        keypoints[:, 9:] = np.nan
    elif case == 'two frames seen':
        keypoints[1:59] = np.nan
    elif case == 'a last frame much later':
        times[59] = 1e4
        keypoints[59, :, :2] += np.random.default_rng(0).normal(0, 3000.0, (15, 2))  # px
    found = reconstruct(make_sequence(keypoints, times, SHOT_CAMERA), MODELS, LIFTER_CONFIG)
    assert np.isfinite(found.solved.poses.joints).all()
    assert (found.outliers[-1].sum() > 10) == (case == 'a last frame much later')


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('keyframes')
    whole = make_recording().sequence()
    cut = {name: getattr(whole, name)[:150] for name in ('keypoints', 'timestamps', 'recorded_ns')}
    first = replace(whole, truth=None, **cut)
    save_sequence(folder / 'demo.npz', first)
    out = folder / 'demo.mcap'
    assert main(['reconstruct', str(folder / 'demo.npz'), '-o', str(out), '--method', 'keyframes']) == 0
    assert is_bag(out)
    return out


def test_the_commands_read_a_bag(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'k.yaml'
    assert main(['keyframes', str(bag), '-o', str(out)]) == 0
    said = capsys.readouterr().out
    assert 'upper body: ' in said
    assert said.endswith(f'{out}\n{tmp_path}/k.png\n{tmp_path}/k_distances.png\n')
    for picture in ('k.png', 'k_distances.png'):
        assert (tmp_path / picture).read_bytes()[:4] == b'\x89PNG'
    keyframes = yaml.safe_load(out.read_text())['keyframes']
    assert {k['half'] for k in keyframes} == {'upper', 'lower'}
    assert sum(k['represents'] for k in keyframes if k['half'] == 'upper') > 100

    plain, chosen = tmp_path / 'plain.npz', tmp_path / 'chosen.npz'
    upper = max((k for k in keyframes if k['half'] == 'upper'), key=lambda k: k['represents'])
    upper['forward'] = ['lelbow', 'rwrist']
    out.write_text(yaml.safe_dump({'keyframes': keyframes}))
    command = ['reconstruct', str(bag), '--method', 'keyframes', '-o']
    assert main([*command, str(plain)]) == 0
    assert main([*command, str(chosen), '--choices', str(out)]) == 0
    with np.load(plain) as a, np.load(chosen) as b:
        assert a['joints3d'].shape == b['joints3d'].shape == (150, 15, 3)
        assert np.abs(a['joints3d'] - b['joints3d']).max() > 0.05
