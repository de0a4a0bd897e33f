# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""OpenPose output: a folder with a file `*_keypoints.json` for each frame."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.formats.detections import Detections, Video, arrange_frames, create_person
from mocap_ros.formats.text_files import read_json
from mocap_ros.keypoints.person import Person2D

FILE_SUFFIX = '_keypoints.json'  # end of the names of OpenPose's files
KEYPOINT_KEYS = ('pose_keypoints_2d', 'pose_keypoints')  # keys of the keypoints since version 1.0 and before
MAX_FRAME_NUMBER_DIGITS = 18  # keeps the number within 64 bits; longer names hold a time before it


def load_openpose(folder: Path, video: Video) -> Detections:
    """Load all people from a folder; the last number in a file's name is the number of the frame.

    Args:
        folder: folder that holds the files.
        video: the frame rate, which is required, and the layout; without a layout 25 keypoints are taken as
            BODY_25 and 18 keypoints as COCO.

    Raises:
        InputError: the folder has no such files, or a file is not valid; the error names the file and the person.
    """
    paths = sorted(folder.glob(f'*{FILE_SUFFIX}'))
    if not paths:
        raise InputError(f'{folder}: no *{FILE_SUFFIX} in it')
    people_by_number: dict[int, list[Person2D]] = {}
    for path in paths:
        digits = re.findall(r'\d+', path.name.removesuffix(FILE_SUFFIX))
        if not digits:
            raise InputError(f'{path}: no frame number in its name')
        number = int(digits[-1][-MAX_FRAME_NUMBER_DIGITS:])
        if number in people_by_number:
            raise InputError(f'{path}: a second frame {number}; a folder must hold one video')
        people_by_number[number] = _read_people(read_json(path), path, video.layout)
    try:
        return arrange_frames(people_by_number, video)
    except InputError as error:
        raise InputError(f'{folder}: {error}') from None


def _read_people(content: Any, path: Path, layout_name: str) -> list[Person2D]:
    """Read all people of a frame of whom a keypoint is seen."""
    entries = content.get('people') if isinstance(content, dict) else None
    if not isinstance(entries, list):
        raise InputError(f'{path}: no list of people; not a frame of OpenPose')
    people = [_read_person(entry, f'{path}: people[{i}]', layout_name) for i, entry in enumerate(entries)]
    return [person for person in people if (person.score > 0).any()]


def _read_person(entry: Any, place: str, layout_name: str) -> Person2D:
    """Read a person; errors begin with `place`."""
    try:
        return _read_keypoints(entry, layout_name)
    except (InputError, SkeletonError) as error:
        raise InputError(f'{place}: {error}') from None


def _read_keypoints(entry: Any, layout_name: str) -> Person2D:
    values = next((entry[key] for key in KEYPOINT_KEYS if key in entry), None) if isinstance(entry, dict) else None
    if values is None:
        raise InputError(f'no {KEYPOINT_KEYS[0]}')
    try:
        keypoints = np.array(values, np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f'{KEYPOINT_KEYS[0]}: expected x, y, score, x, y, score, ...') from None
    ids = entry.get('person_id')
    has_id = isinstance(ids, list) and len(ids) == 1 and isinstance(ids[0], int) and ids[0] >= 0
    return create_person(keypoints, layout_name, str(ids[0]) if has_id else '')
