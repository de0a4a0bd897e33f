# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Folders of OpenPose files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video, select_person
from mocap_ros.formats.detector_json import load_openpose
from mocap_ros.formats.sequence_file import KeypointSequence
from tests.support.keypoint_files import FRAMES, VIDEO, check_same_keypoints, flatten_keypoints


def test_a_folder_gives_the_keypoints_of_every_frame(tmp_path: Path, walker: KeypointSequence) -> None:
    for frame, keypoints in enumerate(flatten_keypoints(walker)):
        person = {'person_id': [-1], 'pose_keypoints_2d': keypoints, 'face_keypoints_2d': []}
        content = {'version': 1.3, 'people': [person]}
        (tmp_path / f'clip2_{frame:012d}_keypoints.json').write_text(json.dumps(content))
    check_same_keypoints(load_openpose(tmp_path, VIDEO), walker)
    (tmp_path / 'clip2_000000000007_keypoints.json').unlink()
    sequence, _ = select_person(load_openpose(tmp_path, VIDEO))
    assert len(sequence) == FRAMES
    assert not sequence.keypoints[7, :, 2].any()
    with pytest.raises(InputError, match='--fps'):
        load_openpose(tmp_path, Video())


PERSON = {'pose_keypoints_2d': [100.0, 100.0, 0.9] * 25}


@pytest.mark.parametrize(
    ('given', 'person_id'), [([3], '3'), ([0], '0'), ([-1], ''), ([3, 4], ''), (3, ''), (None, '')]
)
def test_people_have_the_ids_of_a_tracker(tmp_path: Path, given: object, person_id: str) -> None:
    content = {'people': [{**PERSON, 'person_id': given}]}
    (tmp_path / 'a_1_keypoints.json').write_text(json.dumps(content))
    ((person,),) = load_openpose(tmp_path, VIDEO).people
    assert person.id == person_id


INVALID: dict[str, tuple[dict[str, object], str]] = {
    'no files': ({'a.json': {'people': []}}, r'no \*_keypoints\.json in it'),
    'a name without a number': ({'walk_keypoints.json': {'people': []}}, r'walk_keypoints\.json: no frame number'),
    'two videos': (
        {'cam1_07_keypoints.json': {'people': []}, 'cam2_07_keypoints.json': {'people': []}},
        r'cam2_07_keypoints\.json: a second frame 7; a folder must hold one video',
    ),
    'no frame': ({'1_keypoints.json': [PERSON]}, r'1_keypoints\.json: no list of people; not a frame of OpenPose'),
    'no keypoints': ({'1_keypoints.json': {'people': [PERSON, {}]}}, r'people\[1\]: no pose_keypoints_2d'),
    'no person': ({'1_keypoints.json': {'people': [3]}}, r'people\[0\]: no pose_keypoints_2d'),
    'odd length': (
        {'1_keypoints.json': {'people': [{'pose_keypoints_2d': [1.0, 2.0]}]}},
        r'people\[0\]: pose_keypoints_2d: expected x, y, score, x, y, score',
    ),
    'unknown layout': (
        {'1_keypoints.json': {'people': [{'pose_keypoints_2d': [1.0, 2.0, 0.5]}]}},
        r'people\[0\]: 1 keypoints: no layout known',
    ),
}


@pytest.mark.parametrize('case', INVALID)
def test_a_folder_that_is_not_of_one_video_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    files, message = INVALID[case]
    for name, content in files.items():
        (tmp_path / name).write_text(json.dumps(content))
    with pytest.raises(InputError, match=message) as caught:
        load_openpose(tmp_path, VIDEO)
    assert str(caught.value).startswith(str(tmp_path))
    assert '\n' not in str(caught.value)
