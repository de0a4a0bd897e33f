# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_ros.evaluate`: the errors of results and arrays, and one exception for each wrong argument."""

import math
import warnings
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


def zero_frame(joints: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(joints))[:, None, None] == 5, 0.0, joints)


def unknown(joints: np.ndarray) -> np.ndarray:
    return np.full(joints.shape, np.nan)


@pytest.mark.parametrize(
    ('change', 'place'),
    [
        ({'joints': np.zeros((40, 15, 3)), 'truth': None}, 'joints: frame 0: all joints at one point'),
        ({'joints': lambda truth: truth, 'truth': None}, 'truth: missing'),
        ({'times': np.arange(40)}, 'times: the PoseSequence has its own'),
        ({'joints': np.zeros((40, 17, 3))}, r'joints: shape \(40, 17, 3\), expected \(n, 15, 3\)'),
        ({'joints': lambda truth: truth, 'limbs_only': True}, 'limbs_only: needs a result'),
        ({'joints': lambda truth: truth * 1000}, 'joints: .* looks like mm, m expected'),
        ({'joints': zero_frame}, 'joints: frame 5: all joints at one point'),
        ({'truth': np.ones((39, 15, 3))}, r'truth: shape \(39, 15, 3\), expected \(40, 15, 3\)'),
        ({'truth': unknown}, 'truth: no joint is known in any frame'),
        ({'truth': np.ones((40, 2, 3)), 'truth_names': ['fin', 'tail']}, 'truth_names: only 0 joints'),
        ({'joints': lambda truth: truth, 'times': np.arange(40)[::-1]}, 'times: frame 1: .* is not later'),
        ({'joints': lambda truth: truth, 'times': np.arange(40) * 33.3}, 'times: .* looks like milliseconds'),
    ],
)
def test_a_wrong_argument_is_one_error_that_names_it(
    result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth, change: dict[str, Any], place: str
) -> None:
    arguments = {'joints': result, 'truth': truth, **change}
    for argument in ('joints', 'truth'):
        if callable(arguments[argument]):
            arguments[argument] = arguments[argument](truth.joints)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(mocap_ros.InputError, match=f'^{place}'):
            mocap_ros.evaluate(**arguments)
