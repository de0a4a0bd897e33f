# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_ros.BasePoses`: files, training, and one error for each wrong argument."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.training.fit_base_poses import fit_base_poses


@pytest.fixture(scope='module')
def trial(sequence: mocap_ros.KeypointSequence) -> np.ndarray:
    """Poses (40, 15, 3) in m, z up."""
    assert sequence.truth is not None
    x, y, z = np.moveaxis(sequence.truth.joints, -1, 0)
    return np.stack([x, z, -y], axis=-1)


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
    quick = {'solver.prior': 'pca', 'solver.max_iterations': 2}
    assert mocap_ros.reconstruct(sequence, model=loaded, parameters=quick).base_poses == 'demo'


@pytest.mark.parametrize(
    ('change', 'kind', 'place'),
    [
        ({'trials': lambda trial: [trial * 1000]}, mocap_ros.ModelError, 'trials: trial 0'),
        ({'trials': lambda trial: [trial, trial[:0]]}, mocap_ros.InputError, r'trials\[1\]: no frames'),
        ({'trials': []}, mocap_ros.ModelError, 'trials: training needs'),
        ({'joint_names': 'coco17'}, mocap_ros.InputError, 'joint_names: head, neck, pelvis missing'),
        ({'components': 0}, mocap_ros.InputError, 'components: 0'),
        ({'bodies': 0.5}, mocap_ros.InputError, 'bodies: 0.5'),
        ({'alignment': 'none'}, mocap_ros.InputError, "alignment: 'none'"),
        ({'name': 'a' * 101}, mocap_ros.ModelError, 'name: '),
        ({'provenance': {'a': {1}}}, mocap_ros.ModelError, 'provenance: '),
    ],
)
def test_a_wrong_argument_is_one_error_that_names_it(
    trial: np.ndarray, change: dict[str, Any], kind: type[mocap_ros.MocapError], place: str
) -> None:
    arguments = {'trials': [trial], 'name': 'demo', **change}
    if callable(arguments['trials']):
        arguments['trials'] = arguments['trials'](trial)
    with pytest.raises(mocap_ros.MocapError, match=f'^{place}') as caught:
        mocap_ros.BasePoses.fit(**arguments)
    assert type(caught.value) is kind


@pytest.mark.parametrize('path', ['waltz', None, 5, b'walk', '', 'a\0b', 'a' * 5000])
def test_what_is_no_path_is_refused(path: Any) -> None:
    with pytest.raises(mocap_ros.ModelError, match="'waltz'" if path == 'waltz' else r'^name_or_path: '):
        mocap_ros.BasePoses.load(path)
    with pytest.raises(mocap_ros.MocapError, match=r'waltz/walk\.npz: ' if path == 'waltz' else r'^path: '):
        mocap_ros.BasePoses.load('walk').save('waltz/walk.npz' if path == 'waltz' else path)
