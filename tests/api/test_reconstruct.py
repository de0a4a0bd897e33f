# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`reconstruct`, `Tracker` and `BasePoses` give what solver, tracker and training give, and name wrong input."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.skeleton import BODY26
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.whole_sequence import reconstruct_sequence

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
    models = {'walk': mocap_ros.BasePoses.load('walk')}
    if method == 'whole':
        expected = reconstruct_sequence(sequence, models, config)
    else:
        expected = keyframe_method.reconstruct(sequence, models, config).solved.poses
    given = {**arguments_of(sequence), 'parameters': None, 'model': 'walk', 'method': method}
    result = mocap_ros.reconstruct(**given)
    joints = 15 if method == 'keyframes' else 26
    assert result.base_poses == 'walk'
    assert (len(result), len(result.joint_names), len(result.parents)) == (40, joints, joints)
    for name in ('joints', 'inferred', 'vertical', 'vertical_std', 'reprojection_residual', 'weights'):
        np.testing.assert_array_equal(getattr(result, name), getattr(expected, name))
    assert (result.success, result.cost) == (expected.success, expected.cost)
    assert result.joint_orientation.shape == (40, joints, 4)
    if method == 'keyframes':
        assert np.isnan(result.joint_orientation).all()
        assert result.turn_inferred.all()
    else:
        np.testing.assert_array_equal(result.joint_orientation, expected.joint_orientation)
        np.testing.assert_array_equal(result.turn_inferred, expected.turn_inferred)


def test_a_sequence_is_the_same_as_its_arrays(sequence: mocap_ros.KeypointSequence) -> None:
    given = arguments_of(sequence)
    lists = {name: given[name].tolist() for name in ('keypoints', 'times')}
    by_lists = mocap_ros.reconstruct(**{**given, **lists, 'joint_names': 'coco17'})
    by_sequence = mocap_ros.reconstruct(sequence, parameters=QUICK)
    np.testing.assert_array_equal(by_lists.joints, by_sequence.joints)


def test_the_camera_is_used(sequence: mocap_ros.KeypointSequence) -> None:
    twice = MATRIX * [[2], [2], [1]] - [[0, 0, 320], [0, 0, 240], [0, 0, 0]]
    near, far = (mocap_ros.reconstruct(**arguments_of(sequence), camera_matrix=m) for m in (MATRIX, twice))
    assert near.is_scale_known
    assert not mocap_ros.reconstruct(**arguments_of(sequence)).is_scale_known
    assert far.joints[..., 2].mean() == pytest.approx(2 * near.joints[..., 2].mean(), rel=0.05)


@pytest.mark.parametrize(
    ('matrix', 'options', 'fault'),
    [
        (None, {}, 'the focal length is not known'),
        (MATRIX, {'tracker.vertical': 'none'}, 'the vertical is not known'),
        (MATRIX, {'tracker.vertical': '0 -1 0'}, ''),  # no foot stands long enough to show the size
    ],
)
def test_a_camera_height_is_used_or_a_warning_says_why_not(
    sequence: mocap_ros.KeypointSequence,
    caplog: pytest.LogCaptureFixture,
    matrix: np.ndarray | None,
    options: dict[str, str],
    fault: str,
) -> None:
    given = {**arguments_of(sequence), 'camera_matrix': matrix}
    without = mocap_ros.reconstruct(**{**given, 'parameters': QUICK | options})
    caplog.clear()
    with_it = mocap_ros.reconstruct(**{**given, 'parameters': QUICK | options | {'tracker.camera_height': 2.0}})
    np.testing.assert_array_equal(with_it.joints, without.joints)
    if fault:
        assert f'tracker.camera_height is not used: {fault}' in caplog.text
        np.testing.assert_array_equal(with_it.world_from_camera, without.world_from_camera)
    else:
        assert 'tracker.camera_height' not in caplog.text
        assert with_it.world_from_camera[2, 3] == 2.0


def test_parameters_and_models_have_an_effect(sequence: mocap_ros.KeypointSequence) -> None:
    taller = mocap_ros.reconstruct(sequence, parameters={**QUICK, 'tracker.body_height': 1.9})
    usual = mocap_ros.reconstruct(sequence, parameters=QUICK)
    assert taller.joints[..., 2].mean() > 1.1 * usual.joints[..., 2].mean()
    walk = mocap_ros.BasePoses.load('walk')
    in_columns = replace(walk, components=np.asfortranarray(walk.components))
    by_object = mocap_ros.reconstruct(sequence, model=in_columns, parameters=QUICK)
    by_parameter = mocap_ros.reconstruct(sequence, parameters={**QUICK, 'tracker.model': 'walk'})
    np.testing.assert_array_equal(by_object.joints, by_parameter.joints)


ALL = mocap_ros.BasePoses.load('all')
INPUT, MODEL, CONFIG = mocap_ros.InputError, mocap_ros.ModelError, mocap_ros.ConfigError


@pytest.mark.parametrize(
    ('change', 'kind', 'place'),
    [
        ({'keypoints': np.zeros((40, 17, 2))}, INPUT, r'keypoints: shape'),
        ({'keypoints': 'walk.npz'}, INPUT, 'keypoints: holds <U8, expected numbers'),
        ({'keypoints': lambda points: points / [640, 640, 1]}, INPUT, 'keypoints: looks normalised'),
        ({'joint_names': [f'j{i}' for i in range(17)]}, INPUT, 'joint_names: .* fewer than four joints'),
        ({'joint_names': 'coco16'}, mocap_ros.SkeletonError, "joint_names: unknown keypoint layout 'coco16'"),
        ({'times': None}, INPUT, 'times: missing'),
        ({'times': np.arange(40)[::-1] / 30}, INPUT, 'times: frame 1: 1.2666.* s is not later than frame 0'),
        ({'times': np.arange(40) * 33.3}, INPUT, 'times: one image every 33.3 s .*: looks like milliseconds'),
        ({'times': np.arange(40) / 15e3}, INPUT, 'times: 15000 images/s .*: looks like microseconds'),
        ({'times': np.arange(40) / 30e9}, INPUT, 'times: 30000000000 images/s .*: looks like seconds'),
        ({'image_size': 640}, INPUT, r'image_size: shape \(\), expected \(2\)'),
        ({'image_size': (480, 640), 'keypoints': lambda k: k + [250, 0, 0]}, INPUT, 'image_size: .* transposed'),
        ({'camera_matrix': np.diag([0.006, 0.006, 1])}, INPUT, 'camera_matrix: focal lengths 0.006'),
        ({'camera_matrix': MATRIX + np.outer([1, 0, 0], [0, 0, 9000])}, INPUT, 'camera_matrix: principal point'),
        ({'distortion': [0.1, 0, 0, 0]}, INPUT, 'distortion: needs a camera_matrix'),
        ({'camera_matrix': MATRIX, 'distortion': [0.1, 0, 0]}, INPUT, 'distortion: .* not 3'),
        ({'model': replace(ALL, skeleton=BODY26)}, MODEL, 'model: skeleton: body26, expected cmu15: head, neck'),
        ({'model': replace(ALL, mean=ALL.mean[1:])}, MODEL, 'model: mean: shape'),
        ({'model': 'dance'}, MODEL, "model: no base-pose model 'dance'"),
        ({'parameters': {'solver.prio': 'pca'}}, CONFIG, "parameters: .*; did you mean 'solver.prior'"),
        ({'parameters': {'tracker.body_height': 170}}, CONFIG, 'parameters: tracker.body_height = 170'),
        ({'parameters': {'node.hfov': 30.0}}, CONFIG, 'parameters: node.hfov: .*; give camera_matrix'),
        ({'parameters': {'solver.prior': 'none.npz'}}, MODEL, r'solver\.prior: none\.npz: No such file'),
        ({'method': 'frames'}, INPUT, "method: 'frames', expected whole or keyframes"),
    ],
)
def test_a_wrong_argument_is_one_error_that_names_it(
    sequence: mocap_ros.KeypointSequence, change: dict[str, Any], kind: type[mocap_ros.MocapError], place: str
) -> None:
    given = {**arguments_of(sequence), **change}
    if callable(given['keypoints']):
        given['keypoints'] = given['keypoints'](sequence.keypoints)
    with pytest.raises(mocap_ros.MocapError, match=f'^{place}') as caught:
        mocap_ros.reconstruct(**given)
    assert type(caught.value) is kind


def test_a_sequence_brings_its_own_arguments(sequence: mocap_ros.KeypointSequence) -> None:
    for argument in ('joint_names', 'times', 'image_size', 'camera_matrix', 'distortion'):
        given: dict[str, Any] = {argument: (640, 480)}
        with pytest.raises(INPUT, match=f'{argument}: the KeypointSequence has its own'):
            mocap_ros.reconstruct(sequence, **given)


SIZE = (640, 480)


def make_tracker(**arguments: Any) -> mocap_ros.Tracker:
    return mocap_ros.Tracker(**{'joint_names': 'coco17', 'image_size': SIZE, **arguments})


@pytest.fixture
def keypoints(sequence: mocap_ros.KeypointSequence) -> np.ndarray:
    """One frame of one person, (17, 3)."""
    return sequence.keypoints[0].copy()


def test_the_people_are_those_of_the_node_s_tracker(sequence: mocap_ros.KeypointSequence) -> None:
    inside = PeopleTracker(load_base_pose_models('auto'), mocap_ros.Config())
    tracker = make_tracker()
    for frame, (time_s, stamp_ns) in enumerate(zip(sequence.timestamps, sequence.stamps_ns, strict=True)):
        expected = inside.update(stamp_ns, [sequence.person(frame)], sequence.intrinsics(0.75))
        found = tracker.update(time_s, [sequence.keypoints[frame]])
        assert found.people.ids == expected.people.ids == ('person_1',)
        np.testing.assert_array_equal(found.people.joints, expected.people.joints)
        np.testing.assert_array_equal(found.people.joint_std, expected.people.joint_std)
    assert found.time_s == pytest.approx(sequence.timestamps[-1])
    assert '40 frames' in repr(tracker)
    (person,) = found.people
    assert "'person_1'" in repr(person)
    assert len(person.joint_names) == len(person.joints)


def test_a_repeated_time_drops_the_frame(keypoints: np.ndarray) -> None:
    tracker = make_tracker()
    tracker.update(1.0, [keypoints])
    with pytest.raises(mocap_ros.FrameDropped, match=r'time_s: stamp .* repeats'):
        tracker.update(1.0, [keypoints])
    with pytest.raises(mocap_ros.FrameDropped, match=r'time_s: stamp .* is older'):
        tracker.update(0.9, [keypoints])
    assert len(tracker.update(1.1, [keypoints]).people) == 1


@pytest.mark.parametrize(
    ('change', 'place'),
    [
        ({'time_s': -1.0}, r'time_s: -1\.0'),
        ({'time_s': 1.7e12}, 'time_s: 1700000000000'),
        ({'time_s': 'now'}, "time_s: 'now'"),
        ({'people': np.zeros((1, 18, 3))}, r'people: shape \(1, 18, 3\), expected \(1, 17, 3\)'),
        ({'people': [np.zeros((17, 3)), np.zeros((18, 3))]}, 'people: rows of different lengths'),
        ({'people': np.full((1, 17, 3), 0.5)}, r'people\[0\]: x, y: looks normalised'),
        ({'ids': ['anna', 'ben']}, 'ids: 2 names for 1 people'),
        *(({'ids': ids}, 'ids: .* expected a list of names') for ids in (5, 'a', [b'anna'], [None])),
        ({'people': np.ones((2, 17, 3)) * [90, 90, 1], 'ids': ['a', 'a']}, "ids: id 'a' twice"),
    ],
)
def test_a_wrong_frame_changes_nothing(keypoints: np.ndarray, change: dict[str, Any], place: str) -> None:
    tracker = make_tracker()
    with pytest.raises(INPUT, match=f'^{place}'):
        tracker.update(**{'time_s': 0.0, 'people': [keypoints], **change})
    assert len(tracker.update(0.0, [keypoints]).people) == 1


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'step': 33.3}, 'time_s: one image every 33.3 s by the stamps: looks like milliseconds'),
        ({'step': 1 / 15e3}, 'time_s: 15000 images/s by the stamps: looks like microseconds'),
        ({'image_size': (480, 640), 'shift': 250.0}, 'image_size: .* width and height look transposed'),
    ],
)
def test_thirty_frames_show_a_wrong_unit_or_a_transposed_image(
    sequence: mocap_ros.KeypointSequence, change: dict[str, Any], message: str
) -> None:
    tracker = make_tracker(image_size=change.get('image_size', SIZE))
    shifted = sequence.keypoints + [change.get('shift', 0.0), 0.0, 0.0]
    times = np.arange(40) * change.get('step', 1 / 30)
    for frame in range(29):
        tracker.update(times[frame], [shifted[frame]])
    for frame in (29, 30):
        with pytest.raises(INPUT, match=message):
            tracker.update(times[frame], [shifted[frame]])


def test_seconds_that_are_taken_for_nanoseconds_are_named_at_once() -> None:
    tracker = make_tracker()
    tracker.update(1.76, [])
    with pytest.raises(INPUT, match=r'time_s: 29999\d+ images/s by the stamps: looks like seconds'):
        tracker.update(1.76 + 1 / 30e9, [])


@pytest.fixture(scope='module')
def trial(sequence: mocap_ros.KeypointSequence) -> np.ndarray:
    """Poses (40, 15, 3) in m, z up."""
    assert sequence.truth is not None
    x, y, z = np.moveaxis(sequence.truth.joints, -1, 0)
    return np.stack([x, z, -y], axis=-1)


def test_fitting_is_the_training_with_joints_in_any_order(trial: np.ndarray) -> None:
    expected = fit_base_poses([trial, trial[:20]], name='demo', components=5, mirror=True)
    names = mocap_ros.BasePoses.load('walk').joint_names
    shuffled = [t[:, ::-1].tolist() for t in (trial, trial[:20])]
    fitted = mocap_ros.BasePoses.fit(shuffled, name='demo', joint_names=names[::-1], components=5, mirror=True)
    for array in ('mean', 'components', 'std', 'explained'):
        np.testing.assert_array_equal(getattr(fitted, array), getattr(expected, array))


def test_saved_poses_reconstruct(sequence: mocap_ros.KeypointSequence, trial: np.ndarray, tmp_path: Path) -> None:
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
        ({'trials': lambda trial: [trial * 1000]}, MODEL, 'trials: trial 0'),
        ({'trials': lambda trial: [trial, trial[:0]]}, INPUT, r'trials\[1\]: no frames'),
        ({'trials': []}, MODEL, 'trials: training needs'),
        ({'joint_names': 'coco17'}, INPUT, 'joint_names: head, neck, pelvis missing'),
        ({'components': 0}, INPUT, 'components: 0'),
        ({'bodies': 0.5}, INPUT, 'bodies: 0.5'),
        ({'alignment': 'none'}, INPUT, "alignment: 'none'"),
        ({'name': 'a' * 101}, MODEL, 'name: '),
        ({'provenance': {'a': {1}}}, MODEL, 'provenance: '),
    ],
)
def test_a_wrong_argument_of_fit_is_one_error_that_names_it(
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
    with pytest.raises(MODEL, match="'waltz'" if path == 'waltz' else r'^name_or_path: '):
        mocap_ros.BasePoses.load(path)
    with pytest.raises(mocap_ros.MocapError, match=r'/walk\.npz: ' if path == 'waltz' else r'^path: '):
        mocap_ros.BasePoses.load('walk').save(f'{__file__}/walk.npz' if path == 'waltz' else path)
