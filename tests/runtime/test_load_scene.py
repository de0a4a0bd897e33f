# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The scenes of bags, results and keypoints of any format: what was recorded is what is drawn."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Detections, Video
from mocap_ros.formats.sequence_file import KeypointSequence, save_sequence
from mocap_ros.messages.cdr import Header, decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.runtime import save_results
from mocap_ros.runtime.load_scene import SceneOptions, load_keyframe_marks, load_scene, place_marks
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.runtime.save_results import save_detections
from mocap_ros.runtime.sequence_messages import DEFAULT_FRAME_ID
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Mark, MarkKind
from tests.support.keypoint_files import flatten_keypoints
from tests.support.people import make_person_3d
from tests.support.pipeline_inputs import FAST_CONFIG

FRAMES = 20
MODELS: dict[str, BasePoses] = load_base_pose_models('walk')
OPTIONS = SceneOptions(with_values(Config(), {'solver.max_iterations': 2}), MODELS)


@pytest.fixture(scope='module')
def sequence() -> KeypointSequence:
    """The first frames of the demo recording, with one frame in which nobody is seen."""
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
    scene, lines = load_scene(bag, OPTIONS)
    assert not lines
    assert scene.image_size == sequence.image_size
    assert scene.stamps_ns == sequence.stamps_ns
    assert {person.id for person in scene.people} == {'anna', 'ben'}
    by_id = {person.id: person for person in scene.people}
    row_count = 0
    with Bag(bag) as recorded:
        for frame, message in enumerate(recorded.messages(['/skeletons'])):
            for skeleton in decode(message.raw, SKELETONS).people:
                person = by_id[skeleton.id]
                (row,) = np.flatnonzero(person.frames == frame)
                row_count += 1
                joints = np.array([[j.x, j.y, j.z] for j in skeleton.joints])
                assert person.joints[row] == pytest.approx(joints, abs=1e-5)
                assert person.std[row] == pytest.approx(skeleton.joint_std, nan_ok=True)
                assert person.inferred[row].tolist() == list(skeleton.inferred)
                assert person.image[row].mean(axis=0) == pytest.approx(skeleton.camera.translation, abs=8)
                assert person.residual[row] == pytest.approx(skeleton.reprojection_residual, nan_ok=True)
                states = person.motion[row], person.predicted[row], person.tentative[row]
                assert states == (skeleton.motion.state, skeleton.predicted, skeleton.tentative)
    assert row_count == sum(len(person.frames) for person in scene.people) > FRAMES
    assert by_id['anna'].predicted[by_id['anna'].frames == 12].all()
    (keypoints,) = scene.keypoints
    rows = keypoints.frames == 3
    assert rows.sum() == 2
    assert keypoints.points[rows][0] == pytest.approx(sequence.keypoints[3, :, :2], abs=1e-3, nan_ok=True)
    (drop,) = scene.marks
    assert drop.kind is MarkKind.DROP
    assert drop.time_s == pytest.approx(scene.times[7])
    assert 'repeats' in drop.text


def test_one_person_of_a_bag_is_shown_alone(bag: Path) -> None:
    scene, _ = load_scene(bag, replace(OPTIONS, person='ben'))
    assert [person.id for person in scene.people] == ['ben']
    with pytest.raises(InputError, match="no person 'carl'"):
        load_scene(bag, replace(OPTIONS, person='carl'))
    with pytest.raises(InputError, match='there is no topic /nothing'):
        load_scene(bag, replace(OPTIONS, topic='/nothing'))


def test_a_bag_of_keypoints_shows_all_people(bag: Path) -> None:
    scene, _ = load_scene(bag.with_name('in'), OPTIONS)
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
    whole, _ = load_scene(tmp_path / 'in.npz', OPTIONS)
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
        scene, _ = load_scene(path, OPTIONS)
        (stored,) = scene.people
        assert stored.joints == pytest.approx(person.joints, abs=1e-4)
        assert stored.image == pytest.approx(person.image, abs=1)
        assert stored.inferred.tolist() == person.inferred.tolist()
        assert scene.image_size == pytest.approx(sequence.image_size, abs=1)
        assert bool(scene.keypoints) == (suffix == '.mcap')
        assert scene.intrinsics.is_focal_known == is_calibrated


def test_json_of_two_people_is_reconstructed(sequence: KeypointSequence, tmp_path: Path) -> None:
    results: list[dict[str, Any]] = [
        {'image_id': frame, 'keypoints': row, 'score': 0.9}
        for frame, row in enumerate(flatten_keypoints(sequence))
        if frame != 12
    ]
    for result in list(results):
        moved = np.reshape(result['keypoints'], (-1, 3)) + np.array([-150, 0, 0])
        results.append({**result, 'keypoints': (moved * (moved[:, 2:] > 0)).ravel().tolist()})
    path = tmp_path / 'people.json'
    path.write_text(json.dumps(results), encoding='utf-8')
    with pytest.raises(InputError, match='give the frame rate'):
        load_scene(path, OPTIONS)
    scene, _ = load_scene(path, replace(OPTIONS, video=Video(30.0, (640, 480))))
    assert [person.id for person in scene.people] == ['person_1', 'person_2']
    distance = np.abs(scene.people[0].image[..., 0].mean() - scene.people[1].image[..., 0].mean())
    assert distance == pytest.approx(150, abs=5)
    assert len(scene.keypoints[0].frames) == 2 * (FRAMES - 1)


def test_who_cannot_be_reconstructed_is_left_out_by_name(sequence: KeypointSequence, tmp_path: Path) -> None:
    people = [[sequence.person(frame, 'ann'), sequence.person(frame, 'ben')] for frame in range(12)]
    three_joints = np.arange(len(sequence.joint_names)) < 3
    for row in people:
        row[1] = replace(row[1], score=np.where(three_joints, row[1].score, 0.0))
    save_detections(tmp_path / 'p.mcap', Detections(people, sequence.stamps_ns[:12], (640, 480)))
    scene, lines = load_scene(tmp_path / 'p.mcap', OPTIONS)
    assert [person.id for person in scene.people] == ['ann']
    assert any("person 'ben' left out: no frame has four seen joints" in line for line in lines)
    nobody = [row[1:] for row in people]
    save_detections(tmp_path / 'q.mcap', Detections(nobody, sequence.stamps_ns[:12], (640, 480)))
    with pytest.raises(InputError, match='four seen joints'):
        load_scene(tmp_path / 'q.mcap', OPTIONS)


def test_what_shows_nobody_is_refused(sequence: KeypointSequence, tmp_path: Path) -> None:
    with Recorder(tmp_path / 'empty', RecorderConfig()) as recorder:
        for stamp in sequence.stamps_ns:
            raw = encode_keypoints(Header(stamp, DEFAULT_FRAME_ID), sequence.image_size, [])
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)
    with pytest.raises(InputError, match='empty: nobody is seen'):
        load_scene(tmp_path / 'empty', OPTIONS)
    with Bag(tmp_path / 'empty') as recorded:
        replay(recorded, tmp_path / 'replayed', ReplayOptions(FAST_CONFIG))
    with pytest.raises(InputError, match='replayed: nobody is in any message'):
        load_scene(tmp_path / 'replayed', OPTIONS)


def test_keyframes_become_marks(tmp_path: Path) -> None:
    path = tmp_path / 'k.yaml'
    path.write_text('keyframes:\n- {half: upper, time: 0.5, represents: 3}\n- {time: 2}\n', encoding='utf-8')
    marks = [Mark(0.5, MarkKind.KEYFRAME, 'upper body'), Mark(2.0, MarkKind.KEYFRAME, 'whole body')]
    assert load_keyframe_marks(path) == (marks, None)
    path.write_text('start_ns: 1700000000000000001\n' + path.read_text(), encoding='utf-8')
    assert load_keyframe_marks(path) == (marks, 1_700_000_000_000_000_001)
    for text, reason in (
        ('[]', 'no list of keyframes'),
        ('keyframes: [{time: -1}]', 'keyframe 1: time: -1'),
        ('start_ns: 1.5\nkeyframes: []', 'start_ns: 1.5, expected a whole number of ns'),
        (f'start_ns: 1{"0" * 400}\nkeyframes: []', 'start_ns: 10*[.]{3}, expected a whole number of ns'),
    ):
        path.write_text(text, encoding='utf-8')
        with pytest.raises(InputError, match=f'k.yaml: {reason}'):
            load_keyframe_marks(path)


def test_keyframes_are_placed_by_their_stamps() -> None:
    """Those before and after the scene are left out, but for errors of rounding at its ends."""
    start_ns, stamps_ns = 1_700_000_003_000_000_000, [1_700_000_000_000_000_000, 1_700_000_010_000_000_000]
    marks = [Mark(t, MarkKind.KEYFRAME, 'upper body') for t in (-3.5, -3.0000002, 0.0, 2.5, 7.0000004, 7.5)]
    assert [mark.time_s for mark in place_marks(marks, start_ns, stamps_ns)] == [0.0, 3.0, 5.5, 10.0]
    assert place_marks([], start_ns, stamps_ns) == []
    with pytest.raises(InputError, match='the keyframes are those of another recording'):
        place_marks(marks, 5_000_000_000, stamps_ns)


def test_messages_that_cannot_be_drawn_are_counted(bag: Path, tmp_path: Path) -> None:
    with Bag(bag) as recorded, Recorder(tmp_path / 'odd', RecorderConfig()) as recorder:
        for number, message in enumerate(recorded.messages(['/keypoints', '/skeletons'])):
            raw = message.raw
            if message.type == KEYPOINTS and number < 10:
                broken = decode(raw, KEYPOINTS)
                if number < 5:
                    broken.people[0].x = broken.people[0].x[:3]
                else:
                    broken.people[0].x = np.full(17, np.inf, np.float32)
                raw = encode(broken, KEYPOINTS)
            recorder.write(message.topic, message.type, raw, message.time_ns, message.time_ns)
            if message.type == SKELETONS and number < 8:
                recorder.write('/skeletons', SKELETONS, raw[: len(raw) // 8 * 4], message.time_ns, message.time_ns)
    scene, lines = load_scene(tmp_path / 'odd', OPTIONS)
    (line,) = lines
    assert '9 messages left out; ' in line
    assert scene.keypoints


def test_joints_that_are_not_finite_are_left_out_alone(bag: Path, tmp_path: Path) -> None:
    with Bag(bag) as recorded, Recorder(tmp_path / 'nan', RecorderConfig()) as recorder:
        for message in recorded.messages(['/keypoints', '/skeletons']):
            raw = message.raw
            if message.type == SKELETONS:
                array = decode(raw, SKELETONS)
                for person in array.people:
                    person.joints[4].y = math.nan
                raw = encode(array, SKELETONS)
            recorder.write(message.topic, message.type, raw, message.time_ns, message.time_ns)
    scene, lines = load_scene(tmp_path / 'nan', OPTIONS)
    whole, _ = load_scene(bag, OPTIONS)
    assert not lines
    for person, expected in zip(scene.people, whole.people, strict=True):
        others = np.arange(len(scene.skeleton.joints)) != 4
        assert (person.joints[:, others] == expected.joints[:, others]).all()
        assert np.isnan(person.joints[:, 4, 1]).all()
        assert np.isfinite(person.image[:, others]).all()
    assert scene.intrinsics.focal == pytest.approx(whole.intrinsics.focal, rel=0.05)
    assert np.isfinite([*scene.centre, scene.extent, scene.floor_y]).all()
    assert 'NaN' not in build_page(scene).partition('id="data"')[0]


def test_a_bag_whose_stamps_are_all_equal_is_drawn(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'equal', RecorderConfig()) as recorder:
        for time_ns in range(3):
            raw = encode_skeletons(Header(0, 'camera'), [make_person_3d('a')])
            recorder.write('/skeletons', SKELETONS, raw, time_ns, time_ns)
    scene, _ = load_scene(tmp_path / 'equal', OPTIONS)
    assert scene.stamps_ns == [0]
