# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""COCO keypoints in JSON, and the related files that MMPose, AlphaPose, YOLO and Detectron2 write.

These forms are read. The field `keypoints` holds x, y and the score (or the visibility 0, 1, 2) of the 17 joints
of COCO, or of the joints of another known layout.

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
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.formats.detections import Detections, Video, arrange_frames, create_person
from mocap_ros.formats.text_files import read_json
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import canonical_joint_names

Array = NDArray[np.float64]

MIN_PERSON_SCORE = 0.1  # people with a lower score are left out: COCO results hold many improbable people
VISIBLE = 2.0  # COCO's visibility of a joint that is seen; 1 is a joint that is labelled but hidden
ID_KEYS = ('track_id', 'idx')  # keys of the id that a tracker gives to a person
SCORE_KEYS = ('score', 'bbox_score', 'confidence')  # keys of the score of a person
MAX_FRAME_NUMBER_DIGITS = 18  # keeps the number within 64 bits
MALFORMED = (LookupError, TypeError, ValueError, OverflowError, AttributeError)  # what unexpected content raises


class _Instance(NamedTuple):
    """One person in one frame.

    Attributes:
        frame: number of the frame.
        place: position of the person in the file, for error messages.
        content: content of the file at that position.
    """

    frame: int
    place: str
    content: Mapping[str, Any]


def load_coco(path: Path, video: Video) -> Detections:
    """Load all people from a file, except people with a score below `MIN_PERSON_SCORE`.

    The number of a frame is `frame_id` of its image, else the last number in the image's file name, else the
    image's id.

    Args:
        path: path of the file.
        video: the frame rate, which is required, the layout, and the image size, which a size in the file
            overrides.

    Raises:
        InputError: the file has none of these forms, or its content is not valid; the error names the file and the
            entry.
    """
    content = read_json(path)
    try:
        images = _read_images(content)
        people_by_number: dict[int, list[Person2D]] = {number: [] for number, _ in images.values()}
        number_by_image_id = {image_id: number for image_id, (number, _) in images.items()}
        instances = _read_instances(content, number_by_image_id, people_by_number)
        arrays = [_read_content(_read_keypoints, i) for i in instances]
        scores_are_visibility = _scores_are_visibility(arrays)
        joint_names = _read_joint_names(content)
        for instance, keypoints in zip(instances, arrays, strict=True):
            if scores_are_visibility:
                keypoints[:, 2] /= VISIBLE
            read_person = partial(_create_person, keypoints, video.layout, joint_names)
            person = _read_content(read_person, instance)
            if (person.score > 0).any():
                people_by_number.setdefault(instance.frame, []).append(person)
        sizes = {size for _, size in images.values() if size is not None}
        if len(sizes) > 1:
            raise InputError('images: of different sizes; a file must hold one video')
        size = resolve_image_size(stated=sizes.pop() if sizes else None, configured=video.image_size)
        return arrange_frames(people_by_number, Video(video.fps, size, video.layout))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


def _create_person(
    keypoints: Array, layout_name: str, joint_names: tuple[str, ...], content: Mapping[str, Any]
) -> Person2D:
    return create_person(keypoints, layout_name, _read_id(content), joint_names)


def _read_content(read: Callable[[Mapping[str, Any]], Any], instance: _Instance) -> Any:
    """Apply a function to the content of an instance; errors name the place of the instance."""
    try:
        return read(instance.content)
    except (InputError, SkeletonError) as error:
        raise InputError(f'{instance.place}: {error}') from None
    except MALFORMED:
        raise InputError(f'{instance.place}: keypoints: expected x, y, score of every joint') from None


def _read_images(content: Any) -> dict[Any, tuple[int, tuple[int, int] | None]]:
    """Return the frame number and the size in px (None where unknown) of each image, by the image's id."""
    entries = content.get('images', []) if isinstance(content, dict) else []
    images = {}
    try:
        for image in entries:
            name = image.get('frame_id', image.get('file_name', image['id']))
            size = (int(image['width']), int(image['height'])) if 'width' in image else None
            if size is not None and min(size) < 1:
                raise ValueError
            images[image['id']] = (_parse_frame_number(name), size)
    except MALFORMED:
        raise InputError(f'images[{len(images)}]: expected id, file_name, width, height') from None
    (repeated, count) = next(iter(Counter(number for number, _ in images.values()).most_common(1)), (0, 0))
    if count > 1:
        raise InputError(f'images: several have the frame number {repeated}; a file must hold one video')
    return images


def _check_frame_number(number: int) -> int:
    """Return the number of a frame; OverflowError where it has too many digits."""
    if abs(number) >= 10**MAX_FRAME_NUMBER_DIGITS:
        raise OverflowError
    return number


def _parse_frame_number(name: Any) -> int:
    """Return the frame number in an image's name or id."""
    if isinstance(name, bool):
        raise TypeError
    if isinstance(name, int):
        return _check_frame_number(name)
    digits = re.findall(r'\d+', PurePath(name).stem)
    if not digits:
        raise InputError(f'image {name!r}: no frame number in its name')
    return int(digits[-1][-MAX_FRAME_NUMBER_DIGITS:])


def _read_instances(
    content: Any, number_by_image_id: Mapping[Any, int], people_by_number: dict[int, list[Person2D]]
) -> list[_Instance]:
    """Return all probable people in the file, and add all its frames to `people_by_number`."""
    field = ''
    if isinstance(content, dict):
        field = next((key for key in ('annotations', 'instance_info', 'predictions') if key in content), '')
        if not field:
            hint = '; one frame of OpenPose, give its folder' if 'people' in content else ''
            raise InputError(f'no COCO keypoints: neither annotations nor instance_info in it{hint}')
        content = content[field]
    if not isinstance(content, list):
        raise InputError('no COCO keypoints: expected a list')
    instances = []
    for index, entry in enumerate(content):
        place = f'{field}[{index}]'
        try:
            if isinstance(entry, list):
                frame, people = index, list(entry)
            elif 'instances' in entry:
                frame, people = _check_frame_number(int(entry['frame_id'])), list(entry['instances'])
            else:
                image_id = entry['image_id']
                is_listed = image_id in number_by_image_id
                frame = number_by_image_id[image_id] if is_listed else _parse_frame_number(image_id)
                people = []
                instances.append(_Instance(frame, place, entry))
        except MALFORMED:
            raise InputError(f'{place}: expected image_id and keypoints, or frame_id and instances') from None
        people_by_number.setdefault(frame, [])
        instances += [_Instance(frame, f'{place}.instances[{i}]', person) for i, person in enumerate(people)]
    return [i for i in instances if _is_probable_person(i)]


def _is_probable_person(instance: _Instance) -> bool:
    """Return whether an instance has keypoints, and no score below `MIN_PERSON_SCORE`."""
    content = instance.content
    if not isinstance(content, dict):
        raise InputError(f'{instance.place}: expected a person with keypoints')
    score = next((content[key] for key in SCORE_KEYS if key in content), 1.0)
    is_improbable = isinstance(score, (int, float)) and score < MIN_PERSON_SCORE
    return bool(content.get('keypoints')) and not is_improbable


def _read_keypoints(content: Mapping[str, Any]) -> Array:
    """Return (J, 3) x and y in px and the score; ValueError where the content has another shape."""
    raw = content['keypoints']
    if isinstance(raw, dict):
        ones = [1.0] * len(raw['x'])
        return np.array([raw['x'], raw['y'], raw.get('visible', ones)], np.float64).T
    keypoints = np.array(raw, np.float64)
    if keypoints.ndim == 1:
        return keypoints.reshape(-1, 3)
    if keypoints.ndim == 2 and keypoints.shape[1] == 2:
        score = content.get('keypoint_scores', np.ones(len(keypoints)))
        return np.column_stack([keypoints, np.array(score, np.float64)])
    if keypoints.ndim != 2 or keypoints.shape[1] != 3:
        raise ValueError
    return keypoints


def _scores_are_visibility(arrays: list[Array]) -> bool:
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
