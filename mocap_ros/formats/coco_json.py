"""Keypoints in COCO's JSON and its kin: what MMPose, AlphaPose, YOLO and Detectron2 export.

Understood are, with `keypoints` x, y, score (or visibility 0, 1, 2) of 17 joints, or of another known layout:

- a list of results: {image_id, keypoints, score} (COCO results, YOLO `save_json`), with `idx` or `track_id` where
  people are tracked (AlphaPose);
- annotations: {images, annotations, categories};
- a list of frames, {frame_id, instances: [{keypoints, keypoint_scores, bbox_score}]} (MMPose), or that as
  `instance_info`;
- a list with a list of people for each frame (YOLO `to_json` of every frame; keypoints {x, y, visible}).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.formats.detections import Detections, Video, numbered, person_of
from mocap_ros.formats.text_files import read_json
from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import own_names

Array = NDArray[np.float64]

LEAST_PERSON_SCORE = 0.1
VISIBLE = 2.0
PERSON_IDS = ('track_id', 'idx')
MALFORMED = (LookupError, TypeError, ValueError, OverflowError, AttributeError)
PERSON_SCORES = ('score', 'bbox_score', 'confidence')


class _Instance(NamedTuple):
    """One person in one frame, as the file has it; `place` names it in errors."""

    frame: int
    place: str
    content: Mapping[str, Any]


def load_coco(path: Path, video: Video) -> Detections:
    """Everyone in a file; people scored below `LEAST_PERSON_SCORE` are left out.

    A frame's number is its image's `frame_id`, else the last number in its file name, else its id.

    Args:
        path: of the file.
        video: the frame rate is needed; a size in the file goes before the one here.

    Raises:
        InputError: none of these forms, or content that cannot be used; names the file and the entry.
    """
    content = read_json(path)
    try:
        images = _images(content)
        frames: dict[int, list[Person2D]] = {number: [] for number, _ in images.values()}
        instances = _instances(content, {key: number for key, (number, _) in images.items()}, frames)
        arrays = [_placed(_keypoints, i) for i in instances]
        flags = _are_flags(arrays)
        names = _names(content)
        for instance, keypoints in zip(instances, arrays, strict=True):
            if flags:
                keypoints[:, 2] /= VISIBLE
            person = _placed(lambda i, k=keypoints: person_of(k, video.layout, _id(i), names), instance)
            if (person.score > 0).any():
                frames.setdefault(instance.frame, []).append(person)
        sizes = {size for _, size in images.values() if size is not None}
        if len(sizes) > 1:
            raise InputError('images: of different sizes; one video a file')
        size = sizes.pop() if sizes else video.image_size
        return numbered(frames, Video(video.fps, size, video.layout))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


def _placed(make: Any, instance: _Instance) -> Any:
    """What `make` makes of the content, with errors that say where."""
    try:
        return make(instance.content)
    except (InputError, SkeletonError) as error:
        raise InputError(f'{instance.place}: {error}') from None
    except MALFORMED:
        raise InputError(f'{instance.place}: keypoints: expected x, y, score of every joint') from None


def _images(content: Any) -> dict[Any, tuple[int, tuple[int, int] | None]]:
    """Number and size (px) of the image of every id."""
    listed = content.get('images', []) if isinstance(content, dict) else []
    found = {}
    try:
        for image in listed:
            name = image.get('frame_id', image.get('file_name', image['id']))
            size = (int(image['width']), int(image['height'])) if 'width' in image else None
            if size is not None and min(size) < 1:
                raise ValueError
            found[image['id']] = (_number(name), size)
    except MALFORMED:
        raise InputError(f'images[{len(found)}]: expected id, file_name, width, height') from None
    numbers = [number for number, _ in found.values()]
    if len(set(numbers)) != len(numbers):
        twice = max(numbers, key=numbers.count)
        raise InputError(f'images: several have the frame number {twice}; one video a file')
    return found


def _number(name: Any) -> int:
    """The frame number in an image's name or id."""
    if isinstance(name, int):
        return name
    digits = re.findall(r'\d+', PurePath(name).stem)
    if not digits:
        raise InputError(f'image {name!r}: no frame number in its name')
    return int(digits[-1][-18:])


def _instances(content: Any, numbers: Mapping[Any, int], frames: dict[int, list[Person2D]]) -> list[_Instance]:
    """Everyone in the file; adds the frames that it knows of to `frames`."""
    field = ''
    if isinstance(content, dict):
        field = next((key for key in ('annotations', 'instance_info', 'predictions') if key in content), '')
        if not field:
            hint = '; one frame of OpenPose, give its folder' if 'people' in content else ''
            raise InputError(f'no COCO keypoints: neither annotations nor instance_info in it{hint}')
        content = content[field]
    if not isinstance(content, list):
        raise InputError('no COCO keypoints: expected a list')
    found = []
    for index, entry in enumerate(content):
        place = f'{field}[{index}]'
        try:
            if isinstance(entry, list):
                frame, people = index, list(entry)
            elif 'instances' in entry:
                frame, people = int(entry['frame_id']), list(entry['instances'])
            else:
                frame, people = _frame_of(entry['image_id'], numbers), []
                found.append(_Instance(frame, place, entry))
        except MALFORMED:
            raise InputError(f'{place}: expected image_id and keypoints, or frame_id and instances') from None
        frames.setdefault(frame, [])
        found += [_Instance(frame, f'{place}.instances[{i}]', person) for i, person in enumerate(people)]
    return [i for i in found if _is_person(i)]


def _frame_of(image_id: Any, numbers: Mapping[Any, int]) -> int:
    return numbers[image_id] if image_id in numbers else _number(image_id)


def _is_person(instance: _Instance) -> bool:
    """Whether it has keypoints, and a score worth a look."""
    content = instance.content
    if not isinstance(content, dict):
        raise InputError(f'{instance.place}: expected a person with keypoints')
    score = next((content[key] for key in PERSON_SCORES if key in content), 1.0)
    unlikely = isinstance(score, (int, float)) and score < LEAST_PERSON_SCORE
    return bool(content.get('keypoints')) and not unlikely


def _keypoints(content: Mapping[str, Any]) -> Array:
    """(J, 3) x, y px and score."""
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


def _are_flags(arrays: list[Array]) -> bool:
    """Whether the third numbers are COCO's visibility (0, 1, 2) and no scores."""
    third = np.concatenate([a[:, 2] for a in arrays]) if arrays else np.zeros(0)
    return bool(np.isin(third, (0.0, 1.0, VISIBLE)).all() and (third == VISIBLE).any())


def _names(content: Any) -> tuple[str, ...]:
    """Names of the joints where the file has them."""
    categories = content.get('categories') if isinstance(content, dict) else None
    for category in categories if isinstance(categories, list) else ():
        names = category.get('keypoints') if isinstance(category, dict) else None
        if names and all(isinstance(name, str) for name in names):
            return own_names(names)
    return ()


def _id(content: Mapping[str, Any]) -> str:
    """The name that a tracker gave to a person, or empty."""
    given = next((content[key] for key in PERSON_IDS if key in content), None)
    while isinstance(given, list) and given:
        given = given[0]
    if isinstance(given, float) and given.is_integer():
        given = int(given)
    return str(given) if isinstance(given, (int, str)) else ''
