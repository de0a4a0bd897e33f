"""OpenPose output: a folder with one `*_keypoints.json` a frame."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.formats.detections import Detections, Video, numbered, person_of
from mocap_ros.formats.text_files import read_json
from mocap_ros.keypoints.person import Person2D

ENDING = '_keypoints.json'
KEYS = ('pose_keypoints_2d', 'pose_keypoints')


def load_openpose(folder: Path, video: Video) -> Detections:
    """Everyone in the frames of a folder; the last number in a file's name is that of the frame.

    Args:
        folder: with the files.
        video: the frame rate is needed; 25 keypoints are taken as BODY_25, 18 as COCO.

    Raises:
        InputError: no such files, or one that cannot be used; names the file and the person.
    """
    paths = sorted(folder.glob(f'*{ENDING}'))
    if not paths:
        raise InputError(f'{folder}: no *{ENDING} in it')
    frames: dict[int, list[Person2D]] = {}
    for path in paths:
        digits = re.findall(r'\d+', path.name.removesuffix(ENDING))
        if not digits:
            raise InputError(f'{path}: no frame number in its name')
        number = int(digits[-1][-18:])
        if number in frames:
            raise InputError(f'{path}: a second frame {number}; one video a folder')
        frames[number] = _people(read_json(path), path, video.layout)
    try:
        return numbered(frames, video)
    except InputError as error:
        raise InputError(f'{folder}: {error}') from None


def _people(content: Any, path: Path, layout_name: str) -> list[Person2D]:
    people = content.get('people') if isinstance(content, dict) else None
    if not isinstance(people, list):
        raise InputError(f'{path}: no list of people; not a frame of OpenPose')
    found = [_person(person, f'{path}: people[{index}]', layout_name) for index, person in enumerate(people)]
    return [person for person in found if (person.score > 0).any()]


def _person(person: Any, place: str, layout_name: str) -> Person2D:
    try:
        return _checked(person, layout_name)
    except (InputError, SkeletonError) as error:
        raise InputError(f'{place}: {error}') from None


def _checked(person: Any, layout_name: str) -> Person2D:
    raw = next((person[key] for key in KEYS if key in person), None) if isinstance(person, dict) else None
    if raw is None:
        raise InputError(f'no {KEYS[0]}')
    try:
        keypoints = np.array(raw, np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f'{KEYS[0]}: expected x, y, score, x, y, score, ...') from None
    given = person.get('person_id')
    named = isinstance(given, list) and len(given) == 1 and isinstance(given[0], int) and given[0] >= 0
    return person_of(keypoints, layout_name, str(given[0]) if named else '')
