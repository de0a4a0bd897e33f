# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The evaluation of one sequence: what is compared, what is left out, and what is refused."""

import json
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.evaluation.evaluate import (
    Evaluation,
    evaluate,
)
from mocap_ros.evaluation.metrics import LIMB_JOINTS
from mocap_ros.skeleton import CMU15
from tests.support.swinging_body import make_swinging_body

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


def test_scores_restrict_the_comparison_to_limb_joints_of_well_seen_frames(truth: np.ndarray) -> None:
    scores = np.ones((FRAMES, 15))
    scores[:4] = 0.0
    joints = truth.copy()
    joints[:, [CMU15.index(j) for j in ('head', 'neck', 'pelvis')]] += 1.0
    joints[:4] *= 2.0
    evaluation = evaluate_joints(joints, truth, keypoint_names=CMU15.joints, keypoint_scores=scores)
    assert (evaluation.joints, evaluation.frames) == (len(LIMB_JOINTS), FRAMES - 4)
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
