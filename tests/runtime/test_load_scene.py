# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The scenes of bags, results and keypoints of any format: what was recorded is what is drawn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import KeypointSequence, save_sequence
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.runtime import save_results
from mocap_ros.runtime.load_keypoints import InputOptions
from mocap_ros.runtime.load_scene import SceneOptions, load_scene
from mocap_ros.runtime.playback import DEFAULT_FRAME_ID
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.pipeline_inputs import FAST_CONFIG

FRAMES = 20
MODELS: dict[str, BasePoses] = load_base_pose_models('walk')
OPTIONS = SceneOptions(with_values(Config(), {'solver.max_iterations': 2}), MODELS)


@pytest.fixture(scope='module')
def sequence() -> KeypointSequence:
    """The first frames of the demo recording, with one frame in which no person is seen."""
    whole = make_recording().sequence()
    keypoints = whole.keypoints[:FRAMES].copy()
    keypoints[12] = [np.nan, np.nan, 0]
    return replace(whole, keypoints=keypoints, timestamps=whole.timestamps[:FRAMES] + 5, truth=None)


@pytest.fixture(scope='module')
def bag(sequence: KeypointSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of these keypoints of two people, one message of which repeats a stamp and is dropped."""
    folder = tmp_path_factory.mktemp('bag')
    with Recorder(folder / 'in', RecorderConfig()) as recorder:
        for frame, stamp in enumerate(sequence.stamps_ns):
            anna, ben = sequence.person(frame, 'anna'), sequence.person(frame, 'ben')
            people = [anna, replace(ben, points=ben.points + [-90.0, 10.0])]
            raw = encode_keypoints(Header(stamp, DEFAULT_FRAME_ID), sequence.image_size, people)
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)
            if frame == 7:
                recorder.write('/keypoints', KEYPOINTS, raw, stamp + 1, stamp + 1)
    with Bag(folder / 'in') as recorded:
        replay(recorded, folder / 'out', ReplayOptions(FAST_CONFIG))
    return folder / 'out'


def test_a_bag_is_drawn_as_it_was_recorded(bag: Path, sequence: KeypointSequence) -> None:
    scene, (line,), _ = load_scene(bag, OPTIONS)
    assert '1 messages left out; /keypoints: message 9: ' in line
    assert scene.image_size == sequence.image_size
    assert scene.stamps_ns == sequence.stamps_ns
    assert {person.id for person in scene.people} == {'anna', 'ben'}
    by_id = {person.id: person for person in scene.people}
    with Bag(bag) as recorded:
        arrays = [decode(message.raw, SKELETONS) for message in recorded.messages(['/skeletons'])]
    skeletons = [(frame, skeleton) for frame, array in enumerate(arrays) for skeleton in array.people]
    assert len(skeletons) == sum(len(person.frames) for person in scene.people) > FRAMES
    for frame, skeleton in skeletons:
        person = by_id[skeleton.id]
        (row,) = np.flatnonzero(person.frames == frame)
        joints = np.array([[j.x, j.y, j.z] for j in skeleton.joints])
        assert person.joints[row] == pytest.approx(joints, abs=1e-5)
        assert person.std[row] == pytest.approx(skeleton.joint_std, nan_ok=True)
        assert person.inferred[row].tolist() == list(skeleton.inferred)
        assert person.image[row].mean(axis=0) == pytest.approx(skeleton.camera.translation, abs=8)
        assert person.residual[row] == pytest.approx(skeleton.reprojection_residual, nan_ok=True)
        states = person.motion[row], person.predicted[row], person.tentative[row]
        assert states == (skeleton.motion.state, skeleton.predicted, skeleton.tentative)
    assert by_id['anna'].predicted[by_id['anna'].frames == 12].all()
    (keypoints,) = scene.keypoints
    rows = keypoints.frames == 3
    assert rows.sum() == 2
    assert keypoints.points[rows][0] == pytest.approx(sequence.keypoints[3, :, :2], abs=1e-3, nan_ok=True)
    (drop,) = scene.marks
    assert drop.time_s == pytest.approx(scene.times[7])
    assert 'repeats' in drop.text


def test_one_person_of_a_bag_is_shown_alone(bag: Path) -> None:
    scene, _, _ = load_scene(bag, OPTIONS._replace(input=InputOptions(person='ben')))
    assert [person.id for person in scene.people] == ['ben']
    with pytest.raises(InputError, match="no person 'carl'"):
        load_scene(bag, OPTIONS._replace(input=InputOptions(person='carl')))
    with pytest.raises(InputError, match='there is no topic /nothing'):
        load_scene(bag, OPTIONS._replace(input=InputOptions(topic='/nothing')))


def test_a_bag_of_keypoints_shows_all_people(bag: Path) -> None:
    scene, _, _ = load_scene(bag.with_name('in'), OPTIONS)
    assert [person.id for person in scene.people] == ['anna', 'ben']
    assert all((np.diff(person.frames) == 1).all() for person in scene.people)
    anna, ben = scene.people
    left_of = np.median(ben.image[..., 0] - anna.image[..., 0])
    assert left_of == pytest.approx(-90, abs=15)
    assert (scene.keypoints[0].frames == 12).sum() == 0
    assert anna.predicted[anna.frames == 12].all()


@pytest.mark.parametrize('is_calibrated', [False, True])
def test_a_sequence_file_and_its_results_look_the_same(
    sequence: KeypointSequence, tmp_path: Path, *, is_calibrated: bool
) -> None:
    if is_calibrated:
        matrix = np.array([[480.0, 0, 320], [0, 480, 240], [0, 0, 1]])
        sequence = replace(sequence, camera_matrix=matrix)
    save_sequence(tmp_path / 'in.npz', sequence)
    whole, _, summary = load_scene(tmp_path / 'in.npz', OPTIONS)
    assert summary is not None
    assert (summary.grade, summary.people) == ('good', 1)
    (person,) = whole.people
    intrinsics = sequence.intrinsics(OPTIONS.config.tracker.nominal_focal_length)
    result = reconstruct_sequence(
        sequence.keypoints, sequence.joint_names, sequence.timestamps, intrinsics, MODELS, OPTIONS.config
    )
    assert person.joints == pytest.approx(result.joints, abs=1e-4)
    assert whole.intrinsics.is_focal_known == is_calibrated
    for suffix in ('.npz', '.mcap'):
        path = tmp_path / f'result{suffix}'
        save_results.save(path, save_results.ReconstructedSequence(sequence, result))
        scene, _, _ = load_scene(path, OPTIONS)
        (stored,) = scene.people
        assert stored.joints == pytest.approx(person.joints, abs=1e-4)
        assert stored.image == pytest.approx(person.image, abs=1)
        assert stored.inferred.tolist() == person.inferred.tolist()
        assert scene.image_size == pytest.approx(sequence.image_size, abs=1)
        for found, known in zip(scene.keypoints, whole.keypoints, strict=True):
            seen = found.points[np.isfinite(found.points).any(axis=(1, 2))]
            assert seen == pytest.approx(known.points, abs=1e-3, nan_ok=True)
        assert scene.intrinsics.is_focal_known == is_calibrated
    with np.load(tmp_path / 'result.npz') as archive:  # as earlier versions wrote it
        old = {key: archive[key] for key in archive if not key.startswith(('keypoint', 'image_size', 'camera'))}
    np.savez(tmp_path / 'old.npz', **old)
    scene, _, _ = load_scene(tmp_path / 'old.npz', OPTIONS)
    assert scene.people[0].image == pytest.approx(person.image, abs=1)
    assert not scene.keypoints


def test_what_shows_no_person_is_refused(sequence: KeypointSequence, tmp_path: Path) -> None:
    with Recorder(tmp_path / 'empty', RecorderConfig()) as recorder:
        for stamp in sequence.stamps_ns:
            raw = encode_keypoints(Header(stamp, DEFAULT_FRAME_ID), sequence.image_size, [])
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)
    with pytest.raises(InputError, match='empty: no person is seen'):
        load_scene(tmp_path / 'empty', OPTIONS)
    with Bag(tmp_path / 'empty') as recorded:
        replay(recorded, tmp_path / 'replayed', ReplayOptions(FAST_CONFIG))
    with pytest.raises(InputError, match='replayed: no person is in any message'):
        load_scene(tmp_path / 'replayed', OPTIONS)
