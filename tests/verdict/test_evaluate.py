# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of one sequence and what is left out; points in another layout, order or axes than said are noticed."""

import json
from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.model_file import load_shipped_lifter
from mocap_ros.skeleton import CMU15, keypoint_layout
from mocap_ros.verdict import metrics, plausibility
from mocap_ros.verdict.coverage import compute_coverage
from mocap_ros.verdict.errors_of_result import Evaluation, evaluate
from mocap_ros.verdict.plausibility import (
    GIVEN,
    MIRROR_IMAGE,
    Fault,
    Grade,
    Judgement,
    Reading,
    list_readings,
)
from tests.support.bodies import make_swinging_body

FRAMES = 20
RECORD_KEYS = [
    'mpjpe_mm', 'metric_mpjpe_mm', 'abs_mpjpe_mm', 'root_mm', 'seq_mpjpe_mm', 'pa_mpjpe_mm', 'e_paper_cm',
    'accel_mm_s2', 'joints', 'frames', 'failed_frames', 'bone_std_mm', 'residual_px', 'fps',
]  # fmt: skip


@pytest.fixture
def truth() -> np.ndarray:
    poses, _ = make_swinging_body(FRAMES)
    return poses + [0.2, -0.1, 4.0]


def evaluate_joints(joints: np.ndarray, truth: np.ndarray, **arguments: Any) -> Evaluation:
    given: dict[str, Any] = {'residual': np.full(len(truth), 2.0), 'truth_names': CMU15.joints, 'fps': 30.0}
    return evaluate(joints, CMU15, truth=truth, **(given | arguments))


def test_a_perfect_reconstruction_has_no_errors(truth: np.ndarray) -> None:
    evaluation = evaluate_joints(truth, truth)
    record = evaluation.as_dict()
    assert list(record) == RECORD_KEYS
    for key in RECORD_KEYS[:8]:
        assert record[key] == pytest.approx(0, abs=1e-6), key
    assert (evaluation.joints, evaluation.frames, evaluation.failed_frames) == (15, FRAMES, 0)
    assert evaluation.bone_std_mm == pytest.approx(0, abs=1e-9)
    assert (evaluation.residual_px, evaluation.fps) == (2.0, 30.0)
    assert json.loads(json.dumps(record)) == record


def test_unknown_joints_and_frames_of_the_truth_are_left_out(truth: np.ndarray) -> None:
    partly_known = truth.copy()
    partly_known[:, CMU15.index('head')] = np.nan
    partly_known[:5, CMU15.index('lknee')] = np.nan
    joints = truth.copy()
    joints[:, CMU15.index('head')] += 1.0
    joints[:5] += np.random.default_rng(0).normal(size=joints[:5].shape)
    order = np.arange(15)[::-1]  # the truth is matched by name
    names = tuple(CMU15.joints[i] for i in order)
    evaluation = evaluate_joints(joints, partly_known[:, order], truth_names=names)
    assert (evaluation.joints, evaluation.frames) == (14, FRAMES - 5)
    assert evaluation.mpjpe_mm == pytest.approx(0, abs=1e-6)


NEVER_COMPLETE = np.tile(np.random.default_rng(0).normal(size=(15, 3)), (FRAMES, 1, 1))
NEVER_COMPLETE[np.arange(FRAMES), np.arange(FRAMES) % 2] = np.nan


@pytest.mark.parametrize(
    ('change', 'place'),
    [
        ({'truth': np.full((FRAMES, 15, 3), np.nan)}, 'joints3d: '),
        ({'truth': np.zeros((FRAMES, 15, 3))}, 'joints3d: '),
        ({'truth': np.zeros((FRAMES, 14, 3))}, r'joints3d: shape \(20, 14, 3\)'),
        ({'truth': NEVER_COMPLETE}, 'joints3d: no frame'),
        ({'joints': np.zeros((3, 15, 3))}, r'joints: shape \(3, 15, 3\)'),
        ({'residual': np.zeros(3)}, r'residual: shape \(3,\)'),
        ({'keypoint_names': CMU15.joints, 'keypoint_scores': np.ones((2, 15))}, 'keypoint_scores: shape'),
        ({'keypoint_names': CMU15.joints, 'keypoint_scores': np.zeros((FRAMES, 15))}, 'joints3d: no frame'),
        ({'truth_names': tuple('abcdefghijklmno')}, 'only 0 joints'),
    ],
)
def test_refusals_name_the_field(truth: np.ndarray, change: dict[str, object], place: str) -> None:
    arguments: dict[str, Any] = {'joints': truth, 'truth': truth, **change}
    with pytest.raises(InputError, match=place):
        evaluate_joints(**arguments)


Poses = tuple[np.ndarray, np.ndarray]  # found and true, (F, 15, 3) m


@pytest.fixture
def poses(rng: np.random.Generator) -> Poses:
    truth = np.cumsum(rng.normal(scale=0.02, size=(30, 15, 3)), axis=0) + rng.normal(size=(15, 3))
    return truth + 0.03 * rng.normal(size=truth.shape), truth


def test_agrees_with_the_protocol(protocol: ModuleType, poses: Poses, rng: np.random.Generator) -> None:
    predicted, truth = poses
    predicted[7] = np.nan
    computed = metrics.compute_errors(predicted, truth, fps=30.0)
    expected = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, fps=30.0)
    assert computed.keys() == expected.keys()
    assert computed == pytest.approx(expected, abs=1e-6)
    score = rng.random((30, 15))
    keypoints = np.dstack([truth[..., :2], score])
    wanted = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, keypoints, CMU15.joints, joints='limbs')
    a, b = metrics.match_joints(CMU15.joints, CMU15.joints, limbs_only=True)
    seen = metrics.find_well_seen_frames(CMU15.joints, score)
    assert metrics.compute_errors(predicted[:, a], truth[:, b], 30.0, seen) == pytest.approx(wanted, abs=1e-6)


def test_each_alignment_removes_what_its_name_says(poses: Poses) -> None:
    _, truth = poses
    turned = 1.3 * truth @ rotation_from_vector(np.array([0.1, 0.5, -0.2])).T + [1, 2, 3]
    errors = metrics.compute_errors(turned, truth, 30.0)
    assert errors['seq_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert errors['pa_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert errors['mpjpe_mm'] > 10
    scaled = metrics.compute_errors(truth * 1.1, truth, 30.0)
    assert scaled['mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert scaled['metric_mpjpe_mm'] > 1
    moved = metrics.compute_errors(truth + [0.3, 0, 0], truth, 30.0)
    assert moved['metric_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert moved['root_mm'] == pytest.approx(300)


def test_accelerations_are_compared_where_no_frame_is_missing() -> None:
    times = np.arange(90) / 30
    truth = np.random.default_rng(0).normal(size=(1, 15, 3)) + 0.3 * np.sin(6 * times)[:, None, None]
    predicted = truth * (1 + 0.1 * np.sin(5 * times))[:, None, None]
    all_frames = metrics.compute_errors(predicted, truth, 30.0)['accel_mm_s2']
    kept = np.delete(np.arange(90), [*range(5, 90, 7)])
    some = metrics.compute_errors(predicted[kept], truth[kept], 30.0, times=times[kept])['accel_mm_s2']
    assert some == pytest.approx(all_frames, rel=0.1)
    every_second = slice(None, None, 2)
    alone = metrics.compute_errors(predicted[every_second], truth[every_second], 30.0, times=times[every_second])
    assert np.isnan(alone['accel_mm_s2'])


DRAWN = 4000
STD_M = 0.05
ROOT_COVARIANCE = np.diag([0.01, 0.0004, 0.04]) + 0.005
TRUTH = np.random.default_rng(1).normal(size=(15, 3)) + [0, 0, 4]


def draw(rng: np.random.Generator) -> np.ndarray:
    """Return joints (F, 15, 3) with errors of the covariances above; those of the hips are the root's alone."""
    root = rng.multivariate_normal(np.zeros(3), ROOT_COVARIANCE, DRAWN)
    sight = TRUTH.mean(axis=0) / np.linalg.norm(TRUTH.mean(axis=0))
    own = rng.normal(scale=STD_M / np.sqrt(6), size=(DRAWN, 15, 3))
    own += (own @ sight)[..., None] * sight  # twice as much along the line of sight
    own[:, [CMU15.index('lhip'), CMU15.index('rhip')]] = 0
    return np.asarray(TRUTH + root[:, None] + own)


def measure(factor: float, joints: np.ndarray, names: tuple[str, ...] = CMU15.joints) -> dict[str, float]:
    std = np.full((DRAWN, 15), STD_M * factor)
    std[:, [CMU15.index('lhip'), CMU15.index('rhip')]] = 0
    covariance = np.tile(ROOT_COVARIANCE * factor**2, (DRAWN, 1, 1))
    return compute_coverage(joints, std, covariance, CMU15, np.tile(TRUTH, (DRAWN, 1, 1)), names)


def test_right_covariances_hold_the_share_and_unknown_ones_are_left_out(rng: np.random.Generator) -> None:
    joints = draw(rng)
    known = measure(1.0, joints)
    right = {'joints68': 0.68, 'joints95': 0.95, 'roots68': 0.68, 'roots95': 0.95}
    assert known == pytest.approx(right, abs=0.02)
    half = joints.copy()
    half[::2] = np.nan
    assert measure(1.0, half) == pytest.approx(known, abs=0.03)
    assert measure(1.0, np.full_like(joints, np.nan)) == {}
    without_hips = tuple(f'x{name}' if name.endswith('hip') else name for name in CMU15.joints)
    assert set(measure(1.0, joints, without_hips)) == {'joints68', 'joints95'}
    assert measure(1.0, joints, tuple(f'x{name}' for name in CMU15.joints)) == {}


WALK = make_recording().sequence()
COCO17, H36M17 = (keypoint_layout(name) for name in ('coco17', 'h36m17'))
SOUND_SHARE = 0.02  # 1, residual over the body height
GOOD = Judgement(Grade.GOOD)


def edit(
    keypoints: np.ndarray | None = None,
    joint_names: tuple[str, ...] = WALK.joint_names,
    rows: slice = slice(None),
    swap: bool = False,
    flip: tuple[int, int] = (1, 1),
) -> KeypointSequence:
    """Return the walk under other names, in some of its frames, with x and y exchanged or reversed."""
    found = WALK.keypoints[rows].copy() if keypoints is None else keypoints
    size = np.array(WALK.image_size)
    found[..., :2] = np.where(np.array(flip) < 0, size - found[..., :2], found[..., :2])
    found = found[..., [1, 0, 2]] if swap else found
    times = WALK.timestamps[rows]
    return replace(WALK, keypoints=found, joint_names=joint_names, timestamps=times, recorded_ns=(), truth=None)


def judge_sequence(
    sequence: KeypointSequence, share: float = SOUND_SHARE, vertical: Sequence[float] | None = None
) -> Judgement:
    given = sequence.keypoints, sequence.joint_names, sequence.timestamps, sequence.intrinsics(0.75)
    upward = None if vertical is None else np.array(vertical)
    lifter = load_shipped_lifter()
    parts = [
        {r: plausibility.measure_uncertainty(stretch, r, lifter, 0.1) for r in list_readings(stretch)}
        for stretch in plausibility.cut_stretches(*given, upward)
    ]
    return plausibility.judge(plausibility.average(parts), share)


@pytest.mark.parametrize(
    ('sequence', 'share', 'expected'),
    [
        (edit(), SOUND_SHARE, GOOD),
        (edit(rows=slice(0, None, 4)), SOUND_SHARE, GOOD),
        (edit(rows=slice(60)), SOUND_SHARE, GOOD),
        (edit(WALK.keypoints * np.array([1e4, 1e4, 1])), SOUND_SHARE, GOOD),
        (edit(rows=slice(4)), SOUND_SHARE, Judgement(Grade.GOOD, Fault.UNKNOWN)),
        (edit(rows=slice(4)), 0.08, Judgement(Grade.DOUBTFUL, Fault.MISFIT)),
        (edit(rows=slice(4)), 0.12, Judgement(Grade.WRONG, Fault.MISFIT)),
        (edit(joint_names=H36M17.joints), 0.08, Judgement(Grade.WRONG, Fault.LAYOUT, 'coco17')),
        (edit(WALK.keypoints[:, ::-1]), 0.15, Judgement(Grade.WRONG, Fault.MISFIT)),
        (edit(np.roll(WALK.keypoints, 1, axis=1)), 0.12, Judgement(Grade.WRONG, Fault.MISFIT)),
        (edit(swap=True), SOUND_SHARE, Judgement(Grade.WRONG, Fault.AXES)),
        (edit(flip=(1, -1)), SOUND_SHARE, Judgement(Grade.WRONG, Fault.Y_UP)),
        (edit(flip=(-1, -1)), SOUND_SHARE, Judgement(Grade.WRONG, Fault.TURNED)),
        (edit(swap=True, flip=(1, -1)), SOUND_SHARE, Judgement(Grade.DOUBTFUL, Fault.TURNED)),
    ],
)  # fmt: skip
def test_points_are_judged_by_the_lifter(sequence: KeypointSequence, share: float, expected: Judgement) -> None:
    assert judge_sequence(sequence, share) == expected


@pytest.mark.parametrize(
    ('hidden', 'is_judged'),
    [(('ankle',), True), (('knee',), False), (('hip', 'knee', 'ankle'), False), (('lhip', 'lknee'), False)],
)
def test_left_and_right_are_judged_by_whole_bodies(hidden: tuple[str, ...], *, is_judged: bool) -> None:
    keypoints = WALK.keypoints.copy()
    keypoints[:, [joint.endswith(hidden) for joint in COCO17.joints], 2] = 0
    readings = list_readings(plausibility.Stretch(keypoints, COCO17.joints, WALK.timestamps))
    assert set(readings) >= {GIVEN, *plausibility.TURNED}
    assert set(plausibility.MIRRORED) & set(readings) == (set(plausibility.MIRRORED) if is_judged else set())
    uncertainty = dict.fromkeys(readings, -1.5) | {Reading(turns=2): -1.9, MIRROR_IMAGE: -1.3}
    if not is_judged:
        del uncertainty[MIRROR_IMAGE]
    assert plausibility.judge(uncertainty, 0.02) == Judgement(Grade.WRONG, Fault.TURNED)


def test_a_turned_camera_whose_vertical_is_given_is_sound() -> None:
    assert judge_sequence(edit(flip=(-1, -1)), vertical=(0, 1, 0)) == GOOD
    assert judge_sequence(edit(swap=True, flip=(1, -1)), vertical=(1, 0, 0)) == GOOD
    assert judge_sequence(edit(swap=True, flip=(-1, 1)), vertical=(-1, 0, 0)) == GOOD


@pytest.mark.parametrize(
    ('mirrored', 'layout', 'share', 'size', 'is_backwards', 'expected'),
    [
        (-2.3, -1.2, 0.05, Grade.GOOD, False, GOOD),
        (-2.44, -1.2, 0.05, Grade.GOOD, False, GOOD),
        (-2.46, -1.2, 0.05, Grade.GOOD, False, Judgement(Grade.WRONG, Fault.MIRRORED)),
        (-2.34, -1.2, 0.05, Grade.GOOD, True, GOOD),
        (-2.36, -1.2, 0.05, Grade.GOOD, True, Judgement(Grade.DOUBTFUL, Fault.MIRRORED)),
        (-2.3, -3.0, 0.05, Grade.GOOD, False, GOOD),  # a layout that is hardly another one
        (-2.3, -1.2, 0.06, Grade.GOOD, False, GOOD),
        (-2.3, -1.2, 0.08, Grade.GOOD, False, Judgement(Grade.DOUBTFUL, Fault.MISFIT)),
        (-2.3, -1.2, 0.12, Grade.GOOD, False, Judgement(Grade.WRONG, Fault.MISFIT)),
        (-2.3, -1.2, 0.05, Grade.WRONG, False, Judgement(Grade.WRONG, Fault.SIZE)),
        (-2.3, -1.2, 0.05, Grade.DOUBTFUL, False, Judgement(Grade.DOUBTFUL, Fault.SIZE)),
        (-2.3, -1.2, np.nan, Grade.GOOD, False, GOOD),
    ],
)
def test_only_clear_differences_count(
    mirrored: float, layout: float, share: float, size: Grade, is_backwards: bool, expected: Judgement
) -> None:
    stretch = plausibility.Stretch(WALK.keypoints, COCO17.joints, WALK.timestamps)
    uncertainty = dict.fromkeys(list_readings(stretch), -1.5)
    uncertainty |= {GIVEN: -2.3, MIRROR_IMAGE: mirrored, Reading('h36m17'): layout}
    assert plausibility.judge(uncertainty, share, size, is_backwards=is_backwards) == expected


def test_exchanged_sides_show_under_a_vertical_that_is_given() -> None:
    pitch, truth = np.radians(25.0), make_recording().truth
    turn = Rotation.from_euler('x', pitch).as_matrix()
    joints = (truth - truth.mean(axis=1, keepdims=True)) @ turn.T + [0.0, 0.0, 4.0]
    points = WALK.intrinsics(0.75).project(joints)
    keypoints = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    upward = turn @ [0.0, -1.0, 0.0]
    assert judge_sequence(edit(keypoints, CMU15.joints), vertical=upward) == GOOD
    exchanged = tuple({'l': 'r', 'r': 'l'}.get(name[0], name[0]) + name[1:] for name in CMU15.joints)
    found = judge_sequence(edit(keypoints, exchanged), vertical=upward)
    assert found == Judgement(Grade.WRONG, Fault.MIRRORED)


@pytest.mark.parametrize(
    ('turn', 'speed', 'has_strides', 'expected'),
    [
        (0.0, 1.2, True, False),
        (np.pi, 1.2, True, True),
        (np.pi / 2, 1.2, True, True),
        (np.pi, 0.5, True, False),
        (np.pi, 1.2, False, False),  # the camera drives
    ],
)
def test_who_walks_backwards_faces_away(turn: float, speed: float, has_strides: bool, expected: bool) -> None:
    walk, body = plausibility.Walk(), np.zeros((15, 3))
    place = {'lhip': (0.1, 0.0), 'rhip': (-0.1, 0.0), 'lshoulder': (0.2, -0.5), 'rshoulder': (-0.2, -0.5)}
    for name, (across, height) in place.items():  # faces the camera, or is turned away from it
        body[CMU15.index(name)] = across * np.cos(turn), height, across * np.sin(turn)
    for frame in range(150):
        joints = body + [0.0, 0.0, 5.0 - speed * frame / 30]
        if has_strides:  # one ankle goes on for half a second while the other stays
            whole, part = divmod(frame, 15)
            ways = np.array([(whole + 1) // 2 + part / 15 * (whole % 2), whole // 2 + part / 15 * (1 - whole % 2)])
            joints[[CMU15.index('lankle'), CMU15.index('rankle')], 2] = 5.0 - speed * ways
        walk.add('anna', frame * 10**9 // 30, joints)
    assert walk.is_backwards is expected
