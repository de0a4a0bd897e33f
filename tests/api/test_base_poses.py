# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_ros.BasePoses`: files, training, and one error for each wrong argument."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.training.base_poses import fit_base_poses


@pytest.fixture(scope='module')
def trial(sequence: mocap_ros.KeypointSequence) -> np.ndarray:
    """Poses (40, 15, 3) in m, z up."""
    assert sequence.truth is not None
    x, y, z = np.moveaxis(sequence.truth.joints, -1, 0)
    return np.stack([x, z, -y], axis=-1)


def test_shipped_base_poses_are_loaded_by_name() -> None:
    walk = mocap_ros.BasePoses.load('walk')
    assert walk.name == 'walk'
    assert walk.aligned_by_heading
    assert walk.mean.shape == (15, 3)
    assert repr(walk).startswith("BasePoses 'walk': 41 base poses of 15 joints, stature 1.")
    assert walk.joint_names.index('lwrist') == 4


def test_poses_and_weights_are_inverse() -> None:
    walk = mocap_ros.BasePoses.load('walk')
    weights = np.random.default_rng(0).normal(size=(6, len(walk.std))) * walk.std
    np.testing.assert_allclose(walk.weights(walk.poses(weights)), weights, atol=1e-6)
    shorter = walk.rescale(0.5).truncate(3)
    assert isinstance(shorter, mocap_ros.BasePoses)
    assert (len(shorter.std), shorter.stature) == (3, walk.stature / 2)


def test_fitting_is_the_training_with_joints_in_any_order(trial: np.ndarray) -> None:
    expected = fit_base_poses([trial, trial[:20]], name='demo', components=5, mirror=True)
    names = mocap_ros.BasePoses.load('walk').joint_names
    order = np.arange(15)[::-1]
    shuffled = [t[:, order].tolist() for t in (trial, trial[:20])]
    fitted = mocap_ros.BasePoses.fit(
        shuffled, name='demo', joint_names=[names[i] for i in order], components=5, mirror=True
    )
    for array in ('mean', 'components', 'std', 'explained'):
        np.testing.assert_array_equal(getattr(fitted, array), getattr(expected, array))


def test_saved_base_poses_reconstruct(
    sequence: mocap_ros.KeypointSequence, trial: np.ndarray, tmp_path: Path
) -> None:
    origin = {'source': 'the demo', 'alignment': 'heading'}  # the training knows its alignment better
    fitted = mocap_ros.BasePoses.fit([trial], name='demo', provenance=origin)
    assert not fitted.aligned_by_heading
    fitted.save(tmp_path / 'demo.npz')
    loaded = mocap_ros.BasePoses.load(tmp_path / 'demo.npz')
    assert loaded.provenance['source'] == 'the demo'
    np.testing.assert_allclose(loaded.mean, fitted.mean, atol=1e-6)
    parameters = {'solver.prior': 'pca'}
    own = mocap_ros.evaluate(mocap_ros.reconstruct(sequence, model=loaded, parameters=parameters))
    shipped = mocap_ros.evaluate(mocap_ros.reconstruct(sequence, model='jump', parameters=parameters))
    assert own.mpjpe_mm is not None
    assert shipped.mpjpe_mm is not None
    assert own.mpjpe_mm < 0.8 * shipped.mpjpe_mm


WRONG: dict[str, tuple[dict[str, Any], type[mocap_ros.MocapError], str]] = {
    'mm': ({'scale': 1000}, mocap_ros.ModelError, 'trials: trial 0: joints more than'),
    'one trial without brackets': ({'trials': 'bare'}, mocap_ros.InputError, r'trials\[0\]: shape \(15, 3\)'),
    'a trial without frames': ({'trials': 'empty'}, mocap_ros.InputError, r'trials\[1\]: no frames'),
    'true components': ({'components': True}, mocap_ros.InputError, 'components: True, expected a whole number'),
    'no trial': ({'trials': []}, mocap_ros.ModelError, 'trials: training needs at least two poses'),
    'other joints': ({'joint_names': 'coco17'}, mocap_ros.InputError, 'joint_names: head, neck, pelvis missing'),
    'unknown layout': ({'joint_names': 'cmu'}, mocap_ros.SkeletonError, 'joint_names: unknown keypoint layout'),
    'no components': (
        {'components': 0},
        mocap_ros.InputError,
        'components: 0, expected a whole number of at least 1',
    ),
    'half a body': ({'bodies': 0.5}, mocap_ros.InputError, 'bodies: 0.5, expected a whole number of at least 0'),
    'no trials': ({'trials': None}, mocap_ros.ModelError, 'trials: None, expected a sequence of arrays'),
    'a number for the trials': ({'trials': 5}, mocap_ros.ModelError, 'trials: 5, expected a sequence of arrays'),
    'long name': ({'name': 'a' * 101}, mocap_ros.ModelError, 'name: expected a text of 1 to 100 characters'),
    'name of no text': ({'name': 5}, mocap_ros.ModelError, 'name: expected a text'),
    'provenance of no mapping': (
        {'provenance': [1]},
        mocap_ros.ModelError,
        'provenance: .* expected values by name',
    ),
    'provenance no JSON': ({'provenance': {'a': {1}}}, mocap_ros.ModelError, 'provenance: JSON cannot hold it'),
    'alignment': ({'alignment': 'none'}, mocap_ros.InputError, "^alignment: 'none', expected rotation or heading"),
}


@pytest.mark.parametrize('case', WRONG)
def test_a_wrong_argument_is_one_error_that_names_it(trial: np.ndarray, case: str) -> None:
    change, kind, message = WRONG[case]
    arguments = {'trials': [trial], 'name': 'demo', **change}
    if case == 'mm':
        arguments['trials'] = [trial * arguments.pop('scale')]
    if case == 'one trial without brackets':
        arguments['trials'] = trial
    if case == 'a trial without frames':
        arguments['trials'] = [trial, trial[:0]]
    with pytest.raises(mocap_ros.MocapError, match=message) as caught:
        mocap_ros.BasePoses.fit(**arguments)
    assert type(caught.value) is kind


def test_files_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        mocap_ros.ModelError, match="no base-pose model 'waltz': neither a file nor one of all, jump"
    ):
        mocap_ros.BasePoses.load('waltz')
    with pytest.raises(mocap_ros.MocapError, match='cannot be written'):
        mocap_ros.BasePoses.load('walk').save(tmp_path / 'none' / 'walk.npz')


@pytest.mark.parametrize('path', [None, 5, b'walk', '', 'a\0b', 'a' * 5000])
def test_what_is_no_path_is_refused(path: Any) -> None:
    with pytest.raises(mocap_ros.ModelError, match=r'^name_or_path: '):
        mocap_ros.BasePoses.load(path)
    with pytest.raises(mocap_ros.InputError, match=r'^path: '):
        mocap_ros.BasePoses.load('walk').save(path)
