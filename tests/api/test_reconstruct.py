# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_ros.reconstruct`: the same numbers as inside, and one error for each wrong argument."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.offline.keyframes import reconstruct as keyframes
from mocap_ros.offline.whole_sequence import reconstruct_sequence

MATRIX = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
QUICK = {'solver.max_iterations': 3}


def arguments_of(sequence: mocap_ros.KeypointSequence) -> dict[str, Any]:
    return {
        'keypoints': sequence.keypoints,
        'joint_names': sequence.joint_names,
        'times': sequence.timestamps,
        'image_size': sequence.image_size,
        'parameters': QUICK,
    }


@pytest.mark.parametrize('method', ['whole', 'keyframes'])
def test_the_result_is_that_of_the_solver(sequence: mocap_ros.KeypointSequence, method: str) -> None:
    config = mocap_ros.Config()
    observations = sequence.keypoints, sequence.joint_names, sequence.timestamps, sequence.intrinsics(0.75)
    models = {'walk': mocap_ros.BasePoses.load('walk')}
    if method == 'whole':
        expected = reconstruct_sequence(*observations, models, config)
    else:
        expected = keyframes.reconstruct(*observations, models, config).result
    given = {**arguments_of(sequence), 'parameters': None, 'model': 'walk', 'method': method}
    result = mocap_ros.reconstruct(**given)
    np.testing.assert_array_equal(result.joints, expected.joints)
    np.testing.assert_array_equal(result.seen, expected.seen)
    np.testing.assert_array_equal(result.residual, expected.solution.residual)
    assert result.base_poses == 'walk'
    joints = 15 if method == 'keyframes' else 26
    assert (len(result), len(result.joint_names), len(result.parents)) == (40, joints, joints)
    np.testing.assert_array_equal(result.weights, expected.solution.theta)
    assert (result.success, result.iterations) == (expected.solution.success, expected.solution.iterations)
    assert result.cost == expected.solution.cost
    np.testing.assert_array_equal(result.vertical, expected.vertical)
    np.testing.assert_array_equal(result.vertical_std, expected.vertical_std)
    if method == 'keyframes':
        assert np.isnan(result.orientation).all()
        assert result.turn_inferred.all()
    else:
        np.testing.assert_array_equal(result.orientation, expected.orientation)
        np.testing.assert_array_equal(result.turn_inferred, expected.turn_inferred)
        assert not result.turn_inferred.all()
    assert result.orientation.shape == (40, joints, 4)
    assert result.turn_inferred.shape == (40, joints)


def test_masked_keypoints_are_not_seen(sequence: mocap_ros.KeypointSequence) -> None:
    hidden = np.zeros(sequence.keypoints.shape, bool)
    hidden[10:14] = True
    given = {**arguments_of(sequence), 'model': 'walk'}
    unseen = mocap_ros.reconstruct(**{**given, 'keypoints': np.where(hidden, np.nan, sequence.keypoints)})
    masked = mocap_ros.reconstruct(**{**given, 'keypoints': np.ma.MaskedArray(sequence.keypoints, hidden)})
    np.testing.assert_array_equal(masked.joints, unseen.joints)
    assert not masked.seen[10:14].any()


def test_the_core_alone_has_the_orientations_that_it_has_with_face_feet_and_hands(
    sequence: mocap_ros.KeypointSequence,
) -> None:
    whole = mocap_ros.reconstruct(sequence, parameters=QUICK)
    core = mocap_ros.reconstruct(sequence, parameters={**QUICK, 'tracker.skeleton': 'cmu15'})
    assert core.joint_names == whole.joint_names[:15]
    np.testing.assert_array_equal(core.joints, whole.joints[:, :15])
    np.testing.assert_array_equal(core.orientation, whole.orientation[:, :15])
    np.testing.assert_array_equal(core.turn_inferred, whole.turn_inferred[:, :15])


def test_the_weak_perspective_cameras_show_the_joints_where_they_were_seen(
    sequence: mocap_ros.KeypointSequence,
) -> None:
    result = mocap_ros.reconstruct(sequence)
    centred = result.joints - result.joints.mean(axis=1, keepdims=True)
    image = result.scale[:, None, None] * centred[..., :2] + result.translation[:, None]
    wrist = result.joint_names.index('lwrist')
    keypoint = sequence.keypoints[:, sequence.joint_names.index('lwrist')]
    seen = keypoint[:, 2] > 0
    assert np.median(np.abs(image[:, wrist] - keypoint[:, :2])[seen]) < 10
    assert np.linalg.det(result.rotation) == pytest.approx(1)


def test_a_sequence_is_the_same_as_its_arrays(sequence: mocap_ros.KeypointSequence) -> None:
    by_arrays = mocap_ros.reconstruct(**arguments_of(sequence))
    by_lists = mocap_ros.reconstruct(
        sequence.keypoints.tolist(),
        'coco17',
        sequence.timestamps.tolist(),
        image_size=sequence.image_size,
        parameters=QUICK,
    )
    by_sequence = mocap_ros.reconstruct(sequence, parameters=QUICK)
    np.testing.assert_array_equal(by_sequence.joints, by_arrays.joints)
    np.testing.assert_array_equal(by_lists.joints, by_arrays.joints)


def test_the_camera_is_used(sequence: mocap_ros.KeypointSequence) -> None:
    twice = {
        **arguments_of(sequence),
        'camera_matrix': MATRIX * [[2], [2], [1]] - [[0, 0, 320], [0, 0, 240], [0, 0, 0]],
    }
    near, far = (mocap_ros.reconstruct(**a) for a in ({**twice, 'camera_matrix': MATRIX}, twice))
    assert near.is_scale_known
    assert not mocap_ros.reconstruct(**arguments_of(sequence)).is_scale_known
    assert far.joints[..., 2].mean() == pytest.approx(2 * near.joints[..., 2].mean(), rel=0.05)


def test_parameters_and_models_have_an_effect(sequence: mocap_ros.KeypointSequence) -> None:
    taller = mocap_ros.reconstruct(sequence, parameters={**QUICK, 'tracker.body_height': 1.9})
    usual = mocap_ros.reconstruct(sequence, parameters=QUICK)
    assert taller.joints[..., 2].mean() > 1.1 * usual.joints[..., 2].mean()
    longer = mocap_ros.reconstruct(sequence, parameters={**QUICK, 'tracker.nominal_focal_length': 1.5})
    assert longer.joints[..., 2].mean() == pytest.approx(2 * usual.joints[..., 2].mean(), rel=0.05)
    walk = mocap_ros.BasePoses.load('walk')
    by_object = mocap_ros.reconstruct(sequence, model=walk, parameters=QUICK)
    by_name = mocap_ros.reconstruct(sequence, model='walk', parameters=QUICK)
    by_parameter = mocap_ros.reconstruct(sequence, parameters={**QUICK, 'tracker.model': 'walk'})
    np.testing.assert_array_equal(by_object.joints, by_name.joints)
    np.testing.assert_array_equal(by_object.joints, by_parameter.joints)


def test_a_result_prints_itself(sequence: mocap_ros.KeypointSequence) -> None:
    result = mocap_ros.reconstruct(sequence, parameters={'solver.max_iterations': 1})
    assert not result.success
    assert repr(result).startswith('PoseSequence: 40 frames in 1.3 s, 26 joints (')
    assert repr(result).endswith(result.message)
    assert repr(sequence) == (
        'KeypointSequence: 40 frames in 1.3 s, 17 joints (96% seen) in 640 x 480 px, camera unknown, '
        'truth of 15 joints'
    )


# The wrong arguments, and the error that names each.
WRONG: dict[str, tuple[dict[str, Any], type[mocap_ros.MocapError], str]] = {
    'two columns': (
        {'keypoints': np.zeros((40, 17, 2))},
        mocap_ros.InputError,
        r'keypoints: shape \(40, 17, 2\), expected \(40, 17, 3\)',
    ),
    'another number of joints': (
        {'joint_names': 'halpe26'},
        mocap_ros.InputError,
        r'keypoints: shape \(40, 17, 3\)',
    ),
    'ragged': (
        {'keypoints': [[[1, 2, 3]], [[1, 2]]]},
        mocap_ros.InputError,
        'keypoints: rows of different lengths',
    ),
    'text': ({'keypoints': 'walk.npz'}, mocap_ros.InputError, 'keypoints: holds <U8, expected numbers'),
    'unknown joints': (
        {'joint_names': [f'j{i}' for i in range(17)]},
        mocap_ros.InputError,
        'joint_names: .* fewer than four joints of the body; known: head',
    ),
    'numbers as names': ({'joint_names': range(17)}, mocap_ros.InputError, 'joint_names: expected names'),
    'unknown layout': (
        {'joint_names': 'coco16'},
        mocap_ros.SkeletonError,
        "joint_names: unknown keypoint layout 'coco16'; known: cmu15",
    ),
    'times of fewer frames': (
        {'times': np.arange(39) / 30},
        mocap_ros.InputError,
        r'keypoints: shape \(40, 17, 3\)',
    ),
    'times back': (
        {'times': np.arange(40)[::-1] / 30},
        mocap_ros.InputError,
        'times: frame 1: 1.2666.* s is not later than frame 0',
    ),
    'times in ms': (
        {'times': np.arange(40) * 33.3},
        mocap_ros.InputError,
        'times: 33.3 s from frame to frame: looks like milliseconds; s expected',
    ),
    'times in ns': (
        {'times': np.arange(40) * 33_333_333 + 10**18},
        mocap_ros.InputError,
        'times: .* looks like nano',
    ),
    'no image size': ({'image_size': None}, mocap_ros.InputError, 'image_size: missing'),
    'image size of one number': (
        {'image_size': 640},
        mocap_ros.InputError,
        r'image_size: shape \(\), expected \(2\)',
    ),
    'image size in the wrong order': (
        {'image_size': (480, 640), 'shift': (250, 0)},
        mocap_ros.InputError,
        'image_size: .* width and height look transposed',
    ),
    'shares of the image': ({'scale': 1 / 640}, mocap_ros.InputError, 'keypoints: looks normalised; px expected'),
    'camera matrix in mm': (
        {'camera_matrix': np.diag([0.006, 0.006, 1])},
        mocap_ros.InputError,
        'camera_matrix: focal lengths 0.006',
    ),
    'camera matrix normalised': (
        {'camera_matrix': MATRIX / [[640], [480], [1]]},
        mocap_ros.InputError,
        'camera_matrix: focal lengths 0.9375 and 1.25 px: looks normalised',
    ),
    'camera matrix not finite': (
        {'camera_matrix': MATRIX + [[0, np.nan, 0], [0, 0, 0], [0, 0, 0]]},
        mocap_ros.InputError,
        'camera_matrix: has numbers that are not finite',
    ),
    'camera matrix transposed': (
        {'camera_matrix': MATRIX.T},
        mocap_ros.InputError,
        r'camera_matrix: last row \[320.0, 240.0, 1.0\], expected 0 0 1',
    ),
    'principal point of another image': (
        {'camera_matrix': MATRIX + [[0, 0, 9000], [0, 0, 0], [0, 0, 0]]},
        mocap_ros.InputError,
        'camera_matrix: principal point 9320, 240 px, far outside the image of 640 x 480 px',
    ),
    'distortion alone': (
        {'distortion': [0.1, 0, 0, 0]},
        mocap_ros.InputError,
        'distortion: needs a camera_matrix',
    ),
    'a number as names': ({'joint_names': 5}, mocap_ros.InputError, 'joint_names: expected names'),
    'a path with NUL as model': ({'model': 'a\0b'}, mocap_ros.ModelError, 'model: has a NUL character'),
    'camera matrix as a list': (
        {'camera_matrix': [600, 600]},
        mocap_ros.InputError,
        r'camera_matrix: shape \(2,\)',
    ),
    'three distortion coefficients': (
        {'camera_matrix': MATRIX, 'distortion': [0.1, 0, 0]},
        mocap_ros.InputError,
        'distortion: plumb_bob takes 4 or 5 coefficients, not 3',
    ),
    'unknown model': ({'model': 'dance'}, mocap_ros.ModelError, "model: no base-pose model 'dance'"),
    'model of another type': (
        {'model': 7},
        mocap_ros.ModelError,
        'model: 7: expected a name, a path or BasePoses',
    ),
    'unknown parameter': (
        {'parameters': {'solver.prio': 'pca'}},
        mocap_ros.ConfigError,
        "parameters: unknown parameter 'solver.prio'; did you mean 'solver.prior'",
    ),
    'parameter out of range': (
        {'parameters': {'tracker.body_height': 170}},
        mocap_ros.ConfigError,
        'parameters: tracker.body_height = 170: expected 0.3 to 2.6',
    ),
    'configuration out of range': (
        {'parameters': mocap_ros.Config(keyframes=mocap_ros.Config().keyframes.__class__(iterations=-1))},
        mocap_ros.ConfigError,
        'parameters: keyframes.iterations = -1: expected 0 to 10000',
    ),
    'parameters of another type': (
        {'parameters': ['solver.prior']},
        mocap_ros.ConfigError,
        'parameters: .*: expected values by name, or a Config',
    ),
    'unknown prior': (
        {'parameters': {'solver.prior': 'none.npz'}},
        mocap_ros.ModelError,
        r'solver\.prior: none\.npz: No such file',
    ),
    'unknown method': (
        {'method': 'frames'},
        mocap_ros.InputError,
        "method: 'frames', expected whole or keyframes",
    ),
    'one place': (
        {'keypoints': np.tile([300.0, 200.0, 1.0], (40, 17, 1))},
        mocap_ros.InputError,
        '^keypoints: all seen points lie in one place$',
    ),
    'nobody seen': ({'score': 0.0}, mocap_ros.InputError, 'keypoints: no frame has four seen joints'),
}


@pytest.mark.parametrize('case', WRONG)
def test_a_wrong_argument_is_one_error_that_names_it(sequence: mocap_ros.KeypointSequence, case: str) -> None:
    change, kind, message = WRONG[case]
    given = {**arguments_of(sequence), **change}
    keypoints = np.array(given['keypoints']) if {'shift', 'scale', 'score'} & set(change) else given['keypoints']
    if 'shift' in change:
        keypoints[..., :2] += given.pop('shift')
    if 'scale' in change:
        keypoints[..., :2] *= given.pop('scale')
    if 'score' in change:
        keypoints[..., 2] = given.pop('score')
    with pytest.raises(mocap_ros.MocapError, match=message) as caught:
        mocap_ros.reconstruct(**{**given, 'keypoints': keypoints})
    assert type(caught.value) is kind
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('argument', ['joint_names', 'times', 'image_size', 'camera_matrix', 'distortion'])
def test_a_sequence_brings_its_own_arguments(sequence: mocap_ros.KeypointSequence, argument: str) -> None:
    given: dict[str, Any] = {argument: (640, 480)}
    with pytest.raises(mocap_ros.InputError, match=f'{argument}: the KeypointSequence has its own'):
        mocap_ros.reconstruct(sequence, **given)


WRONG_FIELDS: dict[str, tuple[dict[str, Any], str]] = {
    'id': ({'person_id': 7}, 'person_id: 7, expected a text'),
    'frame': ({'frame_id': None}, 'frame_id: None, expected a text'),
    'calibration': ({'calibration': 3}, 'calibration: 3, expected Intrinsics'),
    'two cameras': ({'camera_matrix': np.eye(3) * 500}, 'calibration: given beside camera_matrix or distortion'),
}


@pytest.mark.parametrize('case', WRONG_FIELDS)
def test_a_wrong_field_of_a_sequence_is_one_error_that_names_it(
    sequence: mocap_ros.KeypointSequence, case: str
) -> None:
    change, message = WRONG_FIELDS[case]
    calibrated = replace(sequence, camera_matrix=None, distortion=None, calibration=sequence.intrinsics(0.75))
    with pytest.raises(mocap_ros.InputError, match=message):
        mocap_ros.reconstruct(replace(calibrated, **change))


def test_stamps_of_a_recording_are_used_as_long_as_the_timestamps_are_theirs(
    sequence: mocap_ros.KeypointSequence,
) -> None:
    stamps = tuple(1_700_000_000_000_000_001 + 33_333_333 * i for i in range(len(sequence)))
    recorded = replace(sequence, timestamps=np.array(stamps) / 1e9, recorded_ns=stamps)
    whole = mocap_ros.reconstruct(recorded, parameters=QUICK).sequence
    assert whole.stamps_ns == list(stamps)
    cut = replace(recorded, keypoints=recorded.keypoints[10:], timestamps=recorded.timestamps[10:], truth=None)
    moved = replace(recorded, timestamps=recorded.timestamps + 1000)
    for changed in (cut, moved):
        found = mocap_ros.reconstruct(changed, parameters=QUICK).sequence
        assert found.stamps_ns == [round(t * 1e9) for t in changed.timestamps.tolist()]


@pytest.mark.parametrize(
    ('size', 'factor', 'is_shown'), [((64, 48), 1, True), ((1, 1), 1, False), ((640, 480), 1000, False)]
)
def test_keypoints_outside_the_image_are_logged(
    sequence: mocap_ros.KeypointSequence,
    caplog: pytest.LogCaptureFixture,
    size: tuple[int, int],
    factor: int,
    is_shown: bool,
) -> None:
    keypoints = sequence.keypoints * [factor, factor, 1]
    given = {**arguments_of(sequence), 'keypoints': keypoints, 'image_size': size}
    if is_shown:
        mocap_ros.reconstruct(**given)
    else:
        with pytest.raises(mocap_ros.InputError, match='no frame has four seen joints'):
            mocap_ros.reconstruct(**given)
    assert any(
        re.fullmatch(
            f'keypoints: [0-9]+% of the seen keypoints lie outside {size[0]} x {size[1]} px', r.getMessage()
        )
        for r in caplog.records
    )
