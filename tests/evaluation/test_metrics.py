"""Errors agree with the measuring protocol, and mean what their names say."""

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.evaluation import metrics
from mocap_ros.geometry.rotations import small_rotation
from mocap_ros.skeleton import CMU15


@pytest.fixture
def poses(rng: np.random.Generator):
    truth = np.cumsum(rng.normal(scale=0.02, size=(30, 15, 3)), axis=0) + rng.normal(size=(15, 3))
    return truth + 0.03 * rng.normal(size=truth.shape), truth


def test_agrees_with_the_protocol(protocol, poses) -> None:
    predicted, truth = poses
    predicted[7] = np.nan
    mine = metrics.errors(predicted, truth, fps=30.0)
    theirs = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, fps=30.0)
    assert mine.keys() == theirs.keys()
    assert mine == pytest.approx(theirs, abs=1e-6)


def test_agrees_with_the_protocol_on_limbs_and_badly_seen_frames(protocol, poses, rng) -> None:
    predicted, truth = poses
    score = rng.random((30, 15))
    keypoints = np.dstack([truth[..., :2], score])
    theirs = protocol.score(predicted, CMU15.joints, truth, CMU15.joints, keypoints, CMU15.joints, joints='limbs')
    a, b = metrics.common_joints(CMU15.joints, CMU15.joints, limbs_only=True)
    seen = metrics.well_seen(CMU15.joints, score)
    assert metrics.errors(predicted[:, a], truth[:, b], 30.0, seen) == pytest.approx(theirs, abs=1e-6)


def test_each_alignment_forgives_what_it_names(poses) -> None:
    _, truth = poses
    turned = 1.3 * truth @ small_rotation(np.array([0.1, 0.5, -0.2])).T + [1, 2, 3]
    errors = metrics.errors(turned, truth, 30.0)
    assert errors['seq_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert errors['pa_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert errors['mpjpe_mm'] > 10
    scaled = metrics.errors(truth * 1.1, truth, 30.0)
    assert scaled['mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert scaled['metric_mpjpe_mm'] > 1
    moved = metrics.errors(truth + [0.3, 0, 0], truth, 30.0)
    assert moved['metric_mpjpe_mm'] == pytest.approx(0, abs=1e-6)
    assert moved['root_mm'] == pytest.approx(300)


def test_nothing_to_score() -> None:
    empty = np.full((4, 15, 3), np.nan)
    assert metrics.errors(empty, np.zeros_like(empty), 30.0) == {'joints': 15, 'frames': 4, 'failed_frames': 4}
    with pytest.raises(InputError, match='only 0 joints in common'):
        metrics.common_joints(['a'], ['b'])
