# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors agree with the measuring protocol, and each alignment removes what its name says."""

from types import ModuleType

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.evaluation import metrics
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.skeleton import CMU15

Poses = tuple[np.ndarray, np.ndarray]  # found and true, (F, 15, 3) m


@pytest.fixture
def poses(rng: np.random.Generator) -> Poses:
    truth = np.cumsum(rng.normal(scale=0.02, size=(30, 15, 3)), axis=0) + rng.normal(size=(15, 3))
    return truth + 0.03 * rng.normal(size=truth.shape), truth


def test_agrees_with_the_protocol_also_on_limbs_and_badly_seen_frames(
    protocol: ModuleType, poses: Poses, rng: np.random.Generator
) -> None:
    predicted, truth = poses
    predicted[7] = np.nan
    computed = metrics.compute_errors(predicted, truth, fps=30.0)
    expected = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, fps=30.0)
    assert computed.keys() == expected.keys()
    assert computed == pytest.approx(expected, abs=1e-6)
    score = rng.random((30, 15))
    keypoints = np.dstack([truth[..., :2], score])
    expected = protocol.score(
        predicted, CMU15.joints, truth, CMU15.joints, keypoints, CMU15.joints, joints='limbs'
    )
    a, b = metrics.match_joints(CMU15.joints, CMU15.joints, limbs_only=True)
    seen = metrics.find_well_seen_frames(CMU15.joints, score)
    assert metrics.compute_errors(predicted[:, a], truth[:, b], 30.0, seen) == pytest.approx(expected, abs=1e-6)


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


def test_without_predictions_only_counts_are_returned() -> None:
    empty = np.full((4, 15, 3), np.nan)
    assert metrics.compute_errors(empty, np.zeros_like(empty), 30.0) == {
        'joints': 15,
        'frames': 4,
        'failed_frames': 4,
    }
    with pytest.raises(InputError, match='only 0 joints in common'):
        metrics.match_joints(['a'], ['b'])


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
