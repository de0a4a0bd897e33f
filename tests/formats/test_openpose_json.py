"""Folders of OpenPose files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video, select_person
from mocap_ros.formats.openpose_json import load_openpose
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
