# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints of people in the JSON of OpenPose, and in that of COCO, MMPose, AlphaPose, YOLO and Detectron2.

OpenPose writes a folder with a file `*_keypoints.json` for each frame. Of the others, a file in one of these forms
is read. The field `keypoints` holds x, y and the score (or the visibility 0, 1, 2) of the 17 joints of COCO, or of
the joints of another known layout.

- A list of results {image_id, keypoints, score}: COCO results and YOLO's `save_json`. AlphaPose adds `idx` or
  `track_id` where it tracks people.
- Annotations {images, annotations, categories}.
- A list of frames {frame_id, instances: [{keypoints, keypoint_scores, bbox_score}]}, or a mapping with that list
  as `instance_info`: MMPose.
- A list that holds the list of people of each frame, with keypoints {x, y, visible}: YOLO's `to_json` of all
  frames.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, naming
from mocap_ros.formats.detections import Detections, Video, arrange_frames, create_person
from mocap_ros.formats.text_files import read_json
from mocap_ros.keypoints.image_size import ImageSize, resolve_image_size
from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import canonical_joint_names

Array = NDArray[np.float64]
Frames = dict[int, list[Person2D]]  # the people in each frame, by the number of the frame

FILE_SUFFIX = '_keypoints.json'  # end of the names of OpenPose's files
OPENPOSE_KEYS = ('pose_keypoints_2d', 'pose_keypoints')  # keys of the keypoints since version 1.0 and before
MIN_PERSON_SCORE = 0.1  # people with a lower score are left out: COCO results hold many improbable people
VISIBLE = 2.0  # COCO's visibility of a joint that is seen; 1 is a joint that is labelled but hidden
ID_KEYS = ('track_id', 'idx')  # keys of the id that a tracker gives to a person
SCORE_KEYS = ('score', 'bbox_score', 'confidence')  # keys of the score of a person
LIST_KEYS = ('annotations', 'instance_info', 'predictions')  # keys of the list of people or frames
MAX_FRAME_NUMBER_DIGITS = 18  # keeps the number within 64 bits; longer names hold a time before it


class _Entry(NamedTuple):
    """One person in one frame: the number of the frame, and the place in the file with the content there."""

    frame: int
    place: str
    content: Mapping[str, Any]


def load_openpose(folder: Path, video: Video) -> Detections:
    """Load all people from a folder; the last number in a file's name is the number of the frame.

    `video` gives the frame rate, which is required, the image size, and the layout if it does not follow from the
    number of keypoints.

    Raises:
        InputError: the folder has no such files, or a file is not valid; the error names the file and the person.
    """
    paths = sorted(folder.glob(f'*{FILE_SUFFIX}'))
    if not paths:
        raise InputError(f'{folder}: no *{FILE_SUFFIX} in it')
    frames: Frames = {}
    for path in paths:
        number = _find_last_number(path.name.removesuffix(FILE_SUFFIX))
        if number is None:
            raise InputError(f'{path}: no frame number in its name')
        if number in frames:
            raise InputError(f'{path}: a second frame {number}; a folder must hold one video')
        content = read_json(path)
        entries = content.get('people') if isinstance(content, dict) else None
        if not isinstance(entries, list):
            raise InputError(f'{path}: no list of people; not a frame of OpenPose')
        frames[number] = []
        for index, entry in enumerate(entries):
            with naming(f'{path}: people[{index}]', f'{OPENPOSE_KEYS[0]}: expected x, y, score, x, y, score, ...'):
                _add_person(frames[number], _read_openpose_person(entry, video.layout))
    with naming(folder):
        return arrange_frames(frames, video)


def load_coco(path: Path, video: Video) -> Detections:
    """Load all people from a file, except people with a score below `MIN_PERSON_SCORE`.

    The number of a frame is `frame_id` of its image, else the last number in the image's file name, else the
    image's id. `video` is as for `load_openpose`; a size in the file overrides that of the images.

    Raises:
        InputError: the file has none of these forms, or its content is not valid; the error names the file and the
            entry.
    """
    content = read_json(path)
    with naming(path):
        number_by_image, size = _read_images(content)
        frames: Frames = {number: [] for number in number_by_image.values()}
        entries = [e for e in _iterate_entries(content, number_by_image, frames) if _is_probable_person(e)]
        arrays = []
        for entry in entries:
            with naming(entry.place, 'keypoints: expected x, y, score of every joint'):
                arrays.append(_read_keypoints(entry.content))
        factor = 1 / VISIBLE if _are_visibilities(arrays) else 1.0
        names = _read_joint_names(content)
        for entry, keypoints in zip(entries, arrays, strict=True):
            keypoints[:, 2] *= factor
            with naming(entry.place):
                person = create_person(keypoints, video.layout, _read_id(entry.content), names)
            _add_person(frames[entry.frame], person)
        size = resolve_image_size(stated=size, configured=video.image_size)
        return arrange_frames(frames, replace(video, image_size=size))


def _add_person(people: list[Person2D], person: Person2D) -> None:
    """Add a person of whom a keypoint is seen."""
    if (person.score > 0).any():
        people.append(person)


def _read_openpose_person(entry: Any, layout_name: str) -> Person2D:
    key = next((key for key in OPENPOSE_KEYS if key in entry), None) if isinstance(entry, dict) else None
    if key is None or entry[key] is None:
        raise InputError(f'no {OPENPOSE_KEYS[0]}')
    ids = entry.get('person_id')
    has_id = isinstance(ids, list) and len(ids) == 1 and isinstance(ids[0], int) and ids[0] >= 0
    keypoints = np.array(entry[key], np.float64).reshape(-1, 3)
    return create_person(keypoints, layout_name, str(ids[0]) if has_id else '')


def _find_last_number(name: str) -> int | None:
    digits = re.findall(r'\d+', name)
    return int(digits[-1][-MAX_FRAME_NUMBER_DIGITS:]) if digits else None


def _parse_frame_number(name: Any) -> int:
    """Return the frame number in an image's name or id; TypeError or OverflowError where it can be none."""
    if isinstance(name, int) and not isinstance(name, bool):
        if abs(name) >= 10**MAX_FRAME_NUMBER_DIGITS:
            raise OverflowError
        return name
    if not isinstance(name, str):
        raise TypeError
    number = _find_last_number(PurePath(name).stem)
    if number is None:
        raise InputError(f'image {name!r}: no frame number in its name')
    return number


def _read_images(content: Any) -> tuple[dict[Any, int], ImageSize | None]:
    """Return the frame number of each image by the image's id, and the size in px, None where no image has one."""
    entries = content.get('images', []) if isinstance(content, dict) else []
    number_by_image, sizes = {}, set()
    with naming('images', 'expected a list'):
        entries = list(entries)
    for index, image in enumerate(entries):
        with naming(f'images[{index}]', 'expected id, file_name, width, height'):
            name = image.get('frame_id', image.get('file_name', image['id']))
            if 'width' in image:
                sizes.add((int(image['width']), int(image['height'])))
                if min(min(size) for size in sizes) < 1:
                    raise ValueError
            number_by_image[image['id']] = _parse_frame_number(name)
    (repeated, count) = next(iter(Counter(number_by_image.values()).most_common(1)), (0, 0))
    if count > 1:
        raise InputError(f'images: several have the frame number {repeated}; a file must hold one video')
    if len(sizes) > 1:
        raise InputError('images: of different sizes; a file must hold one video')
    return number_by_image, next(iter(sizes), None)


def _iterate_entries(content: Any, number_by_image: Mapping[Any, int], frames: Frames) -> Iterator[_Entry]:
    """Yield all people in the file, and add all its frames to `frames`."""
    key = ''
    if isinstance(content, dict):
        key = next((key for key in LIST_KEYS if key in content), '')
        if not key:
            hint = '; one frame of OpenPose, give its folder' if 'people' in content else ''
            raise InputError(f'no COCO keypoints: neither annotations nor instance_info in it{hint}')
        content = content[key]
    if not isinstance(content, list):
        raise InputError('no COCO keypoints: expected a list')
    for index, entry in enumerate(content):
        place = f'{key}[{index}]'
        with naming(place, 'expected image_id and keypoints, or frame_id and instances'):
            if isinstance(entry, list):
                frame, people = index, entry
            elif 'instances' in entry:
                frame, people = _parse_frame_number(int(entry['frame_id'])), list(entry['instances'])
            else:
                image = entry['image_id']
                frame = number_by_image[image] if image in number_by_image else _parse_frame_number(image)
                people = None
        frames.setdefault(frame, [])
        if people is None:
            yield _Entry(frame, place, entry)
        else:
            yield from (_Entry(frame, f'{place}.instances[{i}]', person) for i, person in enumerate(people))


def _is_probable_person(entry: _Entry) -> bool:
    """Return whether a person has keypoints, and no score below `MIN_PERSON_SCORE`."""
    if not isinstance(entry.content, dict):
        raise InputError(f'{entry.place}: expected a person with keypoints')
    score = next((entry.content[key] for key in SCORE_KEYS if key in entry.content), 1.0)
    is_improbable = isinstance(score, (int, float)) and score < MIN_PERSON_SCORE
    return bool(entry.content.get('keypoints')) and not is_improbable


def _read_keypoints(content: Mapping[str, Any]) -> Array:
    """Return (J, 3) x and y in px and the score; one of `MALFORMED` where the content has another shape."""
    raw = content['keypoints']
    if isinstance(raw, dict):
        raw = np.array([raw['x'], raw['y'], raw.get('visible', [1.0] * len(raw['x']))], np.float64).T
    keypoints = np.array(raw, np.float64)
    if keypoints.ndim == 1:
        return keypoints.reshape(-1, 3)
    if keypoints.ndim == 2 and keypoints.shape[1] == 2:
        score = content.get('keypoint_scores', np.ones(len(keypoints)))
        return np.column_stack([keypoints, np.array(score, np.float64)])
    if keypoints.ndim != 2 or keypoints.shape[1] != 3:
        raise ValueError
    return keypoints


def _are_visibilities(arrays: Sequence[Array]) -> bool:
    """Return whether the scores of all keypoints are COCO's visibility (0, 1 or 2)."""
    scores = np.concatenate([a[:, 2] for a in arrays]) if arrays else np.zeros(0)
    return bool(np.isin(scores, (0.0, 1.0, VISIBLE)).all() and (scores == VISIBLE).any())


def _read_joint_names(content: Any) -> tuple[str, ...]:
    """Return the names of the joints, or nothing where the file has none."""
    categories = content.get('categories') if isinstance(content, dict) else None
    for category in categories if isinstance(categories, list) else ():
        names = category.get('keypoints') if isinstance(category, dict) else None
        if names and all(isinstance(name, str) for name in names):
            return canonical_joint_names(names)
    return ()


def _read_id(content: Mapping[str, Any]) -> str:
    """Return the id that a tracker gave to a person, or an empty text."""
    value = next((content[key] for key in ID_KEYS if key in content), None)
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value) if isinstance(value, (int, str)) else ''
