# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of one sequence, and what is left out."""

import json
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.skeleton import CMU15
from mocap_ros.verdict import accuracy
from mocap_ros.verdict.accuracy import Evaluation, evaluate
from mocap_ros.verdict.coverage import compute_coverage
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
        ({'truth': NEVER_COMPLETE}, 'joints3d: no frame'),
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
    computed = accuracy.compute_errors(predicted, truth, fps=30.0)
    expected = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, fps=30.0)
    assert computed.keys() == expected.keys()
    assert computed == pytest.approx(expected, abs=1e-6)
    score = rng.random((30, 15))
    keypoints = np.dstack([truth[..., :2], score])
    wanted = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, keypoints, CMU15.joints, joints='limbs')
    a, b = accuracy.match_joints(CMU15.joints, CMU15.joints, limbs_only=True)
    seen = accuracy.find_well_seen_frames(CMU15.joints, score)
    assert accuracy.compute_errors(predicted[:, a], truth[:, b], 30.0, seen) == pytest.approx(wanted, abs=1e-6)


def test_each_alignment_removes_what_its_name_says(poses: Poses) -> None:
    _, truth = poses
    turned = 1.3 * truth @ rotation_from_vector(np.array([0.1, 0.5, -0.2])).T + [1, 2, 3]
    errors = accuracy.compute_errors(turned, truth, 30.0)
    assert errors['seq_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert errors['pa_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert errors['mpjpe_mm'] > 10
    scaled = accuracy.compute_errors(truth * 1.1, truth, 30.0)
    assert scaled['mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert scaled['metric_mpjpe_mm'] > 1
    moved = accuracy.compute_errors(truth + [0.3, 0, 0], truth, 30.0)
    assert moved['metric_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert moved['root_mm'] == pytest.approx(300)


def test_accelerations_are_compared_where_no_frame_is_missing() -> None:
    times = np.arange(90) / 30
    truth = np.random.default_rng(0).normal(size=(1, 15, 3)) + 0.3 * np.sin(6 * times)[:, None, None]
    predicted = truth * (1 + 0.1 * np.sin(5 * times))[:, None, None]
    all_frames = accuracy.compute_errors(predicted, truth, 30.0)['accel_mm_s2']
    kept = np.delete(np.arange(90), [*range(5, 90, 7)])
    some = accuracy.compute_errors(predicted[kept], truth[kept], 30.0, times=times[kept])['accel_mm_s2']
    assert some == pytest.approx(all_frames, rel=0.1)
    every_second = slice(None, None, 2)
    alone = accuracy.compute_errors(predicted[every_second], truth[every_second], 30.0, times=times[every_second])
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
