# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The JSON of detectors: every form gives the same people, and what is none is refused by its place."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video, associate_people, select_person
from mocap_ros.formats.detector_json import FILE_SUFFIX, MIN_PERSON_SCORE, load_coco, load_openpose
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.runtime.load_keypoints import InputOptions, load_input
from mocap_ros.skeleton import keypoint_layout
from tests.support.keypoint_files import FPS, FRAMES, LIMITS, VIDEO, check_same_keypoints, flatten_keypoints

COCO17 = keypoint_layout('coco17').joints
BODY = [100.0, 100.0, 0.9] * 25


def write_openpose(folder: Path, contents: dict[str, Any]) -> Path:
    """Write a file of OpenPose for each name before its suffix."""
    for name, content in contents.items():
        (folder / f'{name}{FILE_SUFFIX}').write_text(json.dumps(content))
    return folder


def make_mmpose_frames(frames: list[list[float]]) -> list[dict[str, Any]]:
    people = [
        {'keypoints': np.reshape(k, (-1, 3))[:, :2].tolist(), 'keypoint_scores': k[2::3], 'bbox_score': 0.9}
        for k in frames
    ]
    return [{'frame_id': f, 'instances': [person]} for f, person in enumerate(people)]


def make_yolo_person(keypoints: list[float]) -> dict[str, Any]:
    """Return a person as YOLO's `to_json` writes it."""
    x, y, visible = keypoints[::3], keypoints[1::3], keypoints[2::3]
    return {'name': 'person', 'confidence': 0.8, 'keypoints': {'x': x, 'y': y, 'visible': visible}}


def make_annotations(frames: list[list[float]]) -> dict[str, Any]:
    """Return COCO annotations with image ids in reverse order."""
    numbers = range(len(frames))
    return {
        'images': [
            {'id': 900 - f, 'file_name': f'cam1/{f:05d}.png', 'width': 640, 'height': 480} for f in numbers
        ],
        'categories': [{'keypoints': [n.replace('l', 'left_', 1) if n[0] == 'l' else n for n in COCO17]}],
        'annotations': [{'image_id': 900 - f, 'category_id': 1, 'keypoints': frames[f]} for f in numbers],
    }


FORMS: dict[str, Callable[[list[list[float]]], Any]] = {
    'COCO results': lambda k: [{'image_id': i + 100, 'keypoints': p, 'score': 0.9} for i, p in enumerate(k)],
    'AlphaPose': lambda k: [
        {'image_id': f'{i}.jpg', 'category_id': 1, 'keypoints': p, 'score': 2.9, 'idx': [3.0]}
        for i, p in enumerate(k)
    ],
    'MMPose': make_mmpose_frames,
    'MMPose demo': lambda k: {'meta_info': {}, 'instance_info': make_mmpose_frames(k)},
    'YOLO to_json': lambda k: [[make_yolo_person(p)] for p in k],
    'YOLO save_json with improbable people': lambda k: [
        *({'image_id': i, 'keypoints': p, 'score': 0.9} for i, p in enumerate(k)),
        *({'image_id': i, 'keypoints': p, 'score': 0.01} for i, p in enumerate(k)),
    ],
}


@pytest.mark.parametrize('form', FORMS)
def test_every_form_gives_the_same_keypoints(tmp_path: Path, walker: KeypointSequence, form: str) -> None:
    path = tmp_path / 'people.json'
    path.write_text(json.dumps(FORMS[form](flatten_keypoints(walker))))
    check_same_keypoints(load_coco(path, VIDEO), walker)


def test_a_folder_of_openpose_gives_the_keypoints_of_every_frame(tmp_path: Path, walker: KeypointSequence) -> None:
    people = [
        {'person_id': [-1], 'pose_keypoints_2d': k, 'face_keypoints_2d': []} for k in flatten_keypoints(walker)
    ]
    write_openpose(tmp_path, {f'clip2_{f:012d}': {'version': 1.3, 'people': [p]} for f, p in enumerate(people)})
    check_same_keypoints(load_openpose(tmp_path, VIDEO), walker)
    (tmp_path / f'clip2_{7:012d}{FILE_SUFFIX}').unlink()
    sequence, _ = select_person(load_openpose(tmp_path, VIDEO))
    assert len(sequence) == FRAMES
    assert not sequence.keypoints[7, :, 2].any()
    with pytest.raises(InputError, match='--fps'):
        load_openpose(tmp_path, Video())


def test_an_id_that_two_people_of_one_frame_have_is_none(tmp_path: Path) -> None:
    """AlphaPose gives all people the id 0 if it does not track; the ids of a tracker are kept."""
    path = tmp_path / 'people.json'
    shape = np.stack([np.linspace(0, 30, 17), np.linspace(100, 200, 17), np.ones(17)], axis=1)
    people = [
        {'image_id': f'{f}.jpg', 'keypoints': (shape + [x, 0, 0]).ravel().tolist(), 'score': 2.9, 'idx': [idx]}
        for f in range(10)
        for x, idx in ((300, 0.0), (100 + f, 7.0), (500, 0.0))[: 3 if f < 9 else 1]
    ]
    path.write_text(json.dumps(people))
    detections = load_coco(path, VIDEO)
    tracks = {track.id: track for track in associate_people(detections)[0]}
    counts = {name: len(track.detection_by_frame) for name, track in tracks.items()}
    assert counts == {'person_1': 10, 'person_2': 9, '7': 9}
    assert {p.points[0, 0] for p in tracks['person_1'].detection_by_frame.values()} == {300}
    assert detections.notes[0].endswith(': 0')


def test_people_with_a_low_score_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / 'people.json'
    scores = [MIN_PERSON_SCORE, 0.99 * MIN_PERSON_SCORE, 0.3]
    keypoints = [[100.0 * (i + 1), 50.0, 1.0] * 17 for i in range(len(scores))]
    people = [{'image_id': 1, 'keypoints': k, 'score': s} for k, s in zip(keypoints, scores, strict=True)]
    path.write_text(json.dumps(people))
    ((first, second),) = load_coco(path, VIDEO).people
    assert [first.points[0, 0], second.points[0, 0]] == [100, 300]


def test_annotations_give_names_size_and_visibility(tmp_path: Path, walker: KeypointSequence) -> None:
    path = tmp_path / 'people.json'
    visibility = np.nan_to_num(walker.keypoints).reshape(FRAMES, -1, 3).copy()
    visibility[..., 2] = np.where(visibility[..., 2] > 0, 2, 0)
    visibility[3, 0, 2] = 1
    path.write_text(json.dumps(make_annotations(visibility.reshape(FRAMES, -1).tolist())))
    sequence, _ = select_person(load_coco(path, Video(fps=FPS)))
    assert sequence.image_size == (640, 480)
    assert sequence.joint_names == COCO17
    assert sequence.keypoints[0, :, :2] == pytest.approx(walker.keypoints[0, :, :2], nan_ok=True)
    assert set(np.unique(sequence.keypoints[..., 2])) == {0.0, 0.5, 1.0}


@pytest.mark.parametrize(
    ('given', 'person_id'),
    [({'person_id': ids}, name) for ids, name in (([3], '3'), ([0], '0'), ([-1], ''), ([3, 4], ''), (3, ''))]
    + [
        ({'track_id': 5}, '5'),
        ({'track_id': 'anna', 'idx': 3}, 'anna'),
        ({'idx': [[3.0]]}, '3'),
        ({'idx': 0}, '0'),
        ({'idx': 3.5}, ''),
        ({'idx': []}, ''),
        ({'idx': None}, ''),
        ({'id': 7}, ''),  # of an annotation, not of a person
    ],
)
def test_people_have_the_ids_of_a_tracker(tmp_path: Path, given: dict[str, Any], person_id: str) -> None:
    if 'person_id' in given:
        write_openpose(tmp_path, {'a_1': {'people': [{'pose_keypoints_2d': BODY, **given}]}})
        ((person,),) = load_openpose(tmp_path, VIDEO).people
    else:
        (tmp_path / 'a.json').write_text(json.dumps([{'image_id': 1, 'keypoints': BODY[:51], **given}]))
        ((person,),) = load_coco(tmp_path / 'a.json', VIDEO).people
    assert person.id == person_id


def make_images(*images: dict[str, Any]) -> str:
    """Return annotations without people."""
    return json.dumps({'images': images, 'annotations': []})


def make_results(*keypoints: Any) -> str:
    return json.dumps([{'image_id': i, 'keypoints': k} for i, k in enumerate(keypoints)])


@pytest.mark.parametrize(
    ('content', 'place'),
    [
        (make_images({'id': 1, 'file_name': 'cam1/7.png'}, {'id': 2, 'file_name': 'cam2/7.png'}), 'images: .* 7;'),
        (make_images({'id': 1, 'width': 640, 'height': 480}, {'id': 2, 'width': 9, 'height': 9}), 'images: '),
        (make_images({'id': 1}, {'id': 2, 'width': 0, 'height': 480}), r'images\[1\]: expected id'),
        (make_images({'file_name': '1.png'}), r'images\[0\]: expected id'),
        (make_images({'id': 1, 'file_name': 'walk.png'}), r"images\[0\]: image 'walk\.png': no frame number"),
        ('[{"frame_id": 1, "instances": [3]}]', r'\[0\]\.instances\[0\]: expected a person'),
        ('{', 'not JSON'),
        ('[' * 100_000, 'nested too deep'),
        (f'[{"9" * 5000}]', r'value has 5000 digits$'),
        ('3', 'expected a list'),
        ('{"a": 1}', 'neither annotations nor instance_info'),
        ('{"people": []}', 'give its folder'),
        ('[]', 'no frames'),
        ('[{"keypoints": [1, 2, 3]}]', r'\[0\]: expected image_id'),
        ('[{"image_id": true, "keypoints": [1, 2, 3]}]', r'\[0\]: expected image_id'),
        (make_results('abc'), r'\[0\]: keypoints: expected x, y, score'),
        (make_results(BODY[:51], [1, 2, 3, 4]), r'\[1\]: keypoints: expected x, y, score'),
        (make_results(7), r'\[0\]: keypoints: expected x, y, score'),
        (make_results({'x': [[1]], 'y': [[1]], 'visible': [[1]]}), r'\[0\]: keypoints: expected x, y, score'),
        (make_results([1, 2, 1]), r'\[0\]: 1 keypoints: no layout known'),
        (make_results([1e300] * 51), r'\[0\]: x of nose is 1e\+300'),
        (json.dumps([{'image_id': i, 'keypoints': BODY[:51]} for i in (1, 2, 10**9)]), 'not one video of 25 Hz'),
        (make_results([0.5, 0.5, 1.0] * 17), 'look normalised'),
        (make_results([0] * 51), 'nobody is seen'),
    ],
)
def test_invalid_json_is_refused_in_one_line(tmp_path: Path, content: str, place: str) -> None:
    path = tmp_path / 'people.json'
    path.write_text(content)
    with pytest.raises(InputError, match=rf'people\.json: .*{place}') as caught:
        load_input(path, InputOptions(VIDEO, LIMITS))
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('contents', 'place'),
    [
        ({}, 'no .*_keypoints'),
        ({'walk': {'people': []}}, r'walk_keypoints\.json: no frame number'),
        ({'cam1_07': {'people': []}, 'cam2_07': {'people': []}}, r'cam2_07_keypoints\.json: a second frame 7;'),
        ({'1': [{'pose_keypoints_2d': BODY}]}, r'1_keypoints\.json: no list of people'),
        ({'1': {'people': [{'pose_keypoints_2d': BODY}, {}]}}, r'people\[1\]: no pose_keypoints_2d'),
        ({'1': {'people': [3]}}, r'people\[0\]: no pose_keypoints_2d'),
        ({'1': {'people': [{'pose_keypoints_2d': [1.0, 2.0]}]}}, r'people\[0\]: pose_keypoints_2d: expected x, y'),
        (
            {'1': {'people': [{'pose_keypoints_2d': [1.0, 2.0, 0.5]}]}},
            r'people\[0\]: 1 keypoints: no layout known',
        ),
    ],
)
def test_an_invalid_folder_is_refused_in_one_line(tmp_path: Path, contents: dict[str, Any], place: str) -> None:
    with pytest.raises(InputError, match=place) as caught:
        load_openpose(write_openpose(tmp_path, contents), VIDEO)
    assert str(caught.value).startswith(str(tmp_path))
    assert '\n' not in str(caught.value)
