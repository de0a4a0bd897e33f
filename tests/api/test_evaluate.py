# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_ros.evaluate`: the errors of results and arrays, and one exception for each wrong argument."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.evaluation.evaluate import evaluate
from mocap_ros.skeleton import BODY26


@pytest.fixture(scope='module')
def result(sequence: mocap_ros.KeypointSequence) -> mocap_ros.PoseSequence:
    return mocap_ros.reconstruct(sequence, parameters={'solver.max_iterations': 3})


@pytest.fixture
def truth(sequence: mocap_ros.KeypointSequence) -> mocap_ros.GroundTruth:
    assert sequence.truth is not None
    return sequence.truth


@pytest.mark.parametrize('limbs_only', [False, True])
def test_the_errors_of_a_result_are_those_of_the_evaluation(
    result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth, limbs_only: bool
) -> None:
    keypoints = result.sequence
    scores = keypoints.keypoints[..., 2] if limbs_only else None
    fps = 1 / float(np.median(np.diff(result.times)))
    expected = evaluate(
        result.joints, BODY26, result.residual, truth.joints, truth.joint_names, fps, keypoints.joint_names, scores
    )
    own = mocap_ros.evaluate(result, limbs_only=limbs_only)
    assert own == mocap_ros.evaluate(result, truth, limbs_only=limbs_only) == expected
    assert own.joints == (12 if limbs_only else 15)


def test_arrays_have_the_same_errors_without_what_they_do_not_know(
    result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth
) -> None:
    whole = mocap_ros.evaluate(result)
    order = np.arange(15)[::-1]
    names = [truth.joint_names[i].replace('lk', 'left_k') for i in order]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        by_arrays = mocap_ros.evaluate(result.joints.tolist(), truth.joints[:, order], truth_names=names)
    assert math.isnan(by_arrays.residual_px)
    assert math.isnan(by_arrays.accel_mm_s2 or 0.0)
    assert by_arrays.mpjpe_mm == pytest.approx(whole.mpjpe_mm)
    with_times = mocap_ros.evaluate(result.joints, truth.joints, times=result.times)
    assert with_times.accel_mm_s2 == pytest.approx(whole.accel_mm_s2)


def test_frames_without_a_person_are_counted(result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth) -> None:
    joints = result.joints.copy()
    joints[:7] = np.nan
    evaluation = mocap_ros.evaluate(joints, truth)
    assert (evaluation.frames, evaluation.failed_frames) == (40, 7)


def test_a_joint_that_is_never_predicted_fails_every_frame_without_warnings(truth: mocap_ros.GroundTruth) -> None:
    joints = truth.joints.copy()
    joints[:, 3] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        evaluation = mocap_ros.evaluate(joints, truth)
    assert (evaluation.failed_frames, evaluation.mpjpe_mm) == (40, None)
    assert math.isnan(evaluation.bone_std_mm)


def test_an_evaluation_prints_itself(truth: mocap_ros.GroundTruth) -> None:
    moved = truth.joints + [0.0, 0.0, 0.5]
    assert repr(mocap_ros.evaluate(moved, truth)) == (
        'Evaluation: MPJPE 0.0 mm, PA-MPJPE 0.0 mm, without a scale 0.0 mm, 15 joints in 40 frames, '
        '0 of them failed'
    )


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    'no truth': ({'joints': 'untrue'}, 'truth: missing'),
    'no truth for an array': ({'joints': np.zeros((40, 15, 3))}, 'truth: missing'),
    'times for a result': ({'times': np.arange(40)}, 'times: the PoseSequence has its own'),
    'other joints': ({'joints': np.zeros((40, 17, 3))}, r'joints: shape \(40, 17, 3\), expected \(n, 15, 3\)'),
    'ragged joints': (
        {'joints': [np.zeros((15, 3)).tolist(), np.zeros((14, 3)).tolist()]},
        'joints: rows of different lengths',
    ),
    'limbs of an array': ({'joints': np.zeros((40, 15, 3)), 'limbs_only': True}, 'limbs_only: needs a result'),
    'other frames': ({'truth': np.ones((39, 15, 3))}, r'truth: shape \(39, 15, 3\), expected \(40, 15, 3\)'),
    'other names': ({'truth': np.ones((40, 3, 3)), 'truth_names': ['a', 'b']}, r'truth: shape \(40, 3, 3\)'),
    'unknown everywhere': ({'truth': np.full((40, 15, 3), np.nan)}, 'truth: no joint is known in any frame'),
    'one place': ({'truth': np.ones((40, 15, 3))}, 'truth: all joints at one place'),
    'mm': ({'truth': 'mm'}, 'truth: .* m expected'),
    'the joints in mm': ({'joints': 'mm', 'truth': 'own'}, 'joints: a person .* looks like mm, m expected'),
    'an infinite joint': ({'joints': 'infinite', 'truth': 'own'}, 'joints: frame 3: joint 2 is more than'),
    'all joints zero': (
        {'joints': np.zeros((40, 15, 3)), 'truth': 'own'},
        'joints: frame 0: all joints at one place',
    ),
    'a frame of zeros': ({'joints': 'zero frame', 'truth': 'own'}, 'joints: frame 5: all joints at one place'),
    'an infinite truth': ({'truth': 'infinite'}, 'truth: frame 3: joint 2 is more than'),
    'times of zero': ({'joints': 'own', 'truth': 'own', 'times': np.zeros(40)}, 'times: frame 1: .* repeats'),
    'times back': (
        {'joints': 'own', 'truth': 'own', 'times': np.arange(40)[::-1]},
        'times: frame 1: .* is not later',
    ),
    'times not finite': ({'joints': 'own', 'truth': 'own', 'times': np.full(40, np.nan)}, 'times: frame 0: nan'),
    'times in ms': (
        {'joints': 'own', 'truth': 'own', 'times': np.arange(40) * 33.3},
        'times: .* looks like milliseconds',
    ),
    'a number for the names': ({'truth': 'own', 'truth_names': 5}, 'truth_names: expected names'),
    'None for the names': ({'truth': 'own', 'truth_names': None}, 'truth_names: expected names'),
    'an empty truth': ({'truth': mocap_ros.GroundTruth(None, None)}, 'truth: expected names'),  # type: ignore[arg-type]
    'no common joints': (
        {'truth': np.ones((40, 2, 3)), 'truth_names': ['fin', 'tail']},
        'truth_names: only 0 joints .*; the truth has fin, tail; the result has head, neck',
    ),
    'times of other frames': (
        {'joints': np.zeros((40, 15, 3)), 'truth': np.zeros((40, 15, 3)), 'times': np.arange(3)},
        r'times: shape \(3,\), expected \(40\)',
    ),
}


@pytest.mark.parametrize('case', WRONG)
def test_a_wrong_argument_is_one_error_that_names_it(
    result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth, case: str
) -> None:
    change, message = WRONG[case]
    arguments = {'joints': result, **change}
    if case == 'no truth':
        arguments['joints'] = mocap_ros.reconstruct(
            replace(result.sequence, truth=None), parameters={'solver.max_iterations': 1}
        )
    infinite = truth.joints.copy()
    infinite[3, 2, 1] = np.inf
    zero_frame = truth.joints.copy()
    zero_frame[5] = 0.0
    arrays = {
        'mm': truth.joints * 1000,
        'infinite': infinite,
        'zero frame': zero_frame,
        'own': truth.joints,
    }
    for argument in ('joints', 'truth'):
        if isinstance(arguments.get(argument), str) and arguments[argument] in arrays:
            arguments[argument] = arrays[arguments[argument]]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(mocap_ros.InputError, match=message):
            mocap_ros.evaluate(**arguments)


def test_an_unknown_layout_of_the_truth_is_refused(result: mocap_ros.PoseSequence) -> None:
    with pytest.raises(mocap_ros.SkeletonError, match='truth_names: unknown keypoint layout'):
        mocap_ros.evaluate(result, np.ones((40, 15, 3)), truth_names='cmu')
