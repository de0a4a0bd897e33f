# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints of people in the JSON of detectors: OpenPose, COCO, MMPose, AlphaPose, YOLO, Detectron2, ViTPose.

A folder holds a file for each frame, as OpenPose, Pose2Sim, AlphaPose and MMPoseInferencer write them: a mapping
with the list of `people`, or the list itself. Of single files, these forms are read:

- A list of results {image_id, keypoints, score}: COCO results, Detectron2 and YOLO's `save_json`. AlphaPose adds
  `idx` or `track_id` where it tracks people.
- Annotations {images, annotations, categories}.
- A list of frames {frame_id, instances: [{keypoints, keypoint_scores, bbox_score}]}, or a mapping with that list
  as `instance_info` and the names of the joints as `meta_info`: MMPose.
- A list that holds the list of people of each frame, with keypoints {x, y, visible}: YOLO's `to_json` of all
  frames.
- A list of frames {frame_id, predictions: [...], image: {width, height}}: Roboflow.
- A mapping of the name of each image to {people} or {bodies}: AlphaPose in the formats of OpenPose and CMU-Pose.
- {keypoints: [{id: [[y, x, score], ...]} of each frame], skeleton: names}: easy_ViTPose.

Any of these may state the time of an image (`timestamp`, in s, or `timestamp_ms` and the like).

`json_keypoints` reads the keypoints of a person: x, y and the score (or the visibility 0, 1, 2) of the joints of a
known layout, or of those that the file names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.errors import InputError, naming
from mocap_ros.formats.detections import (
    MAX_KEYPOINTS,
    SECONDS_BY_KEY,
    Detections,
    arrange_frames,
    create_person,
    list_some,
)
from mocap_ros.formats.image_names import MAX_FRAME_NUMBER, ImageName
from mocap_ros.formats.json_keypoints import (
    NAME_KEYS,
    JsonKeypoints,
    Names,
    arrange_labels,
    list_names,
    read_keypoints,
)
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.text_files import read_json
from mocap_ros.keypoints.image_size import ImageSize, resolve_image_size
from mocap_ros.keypoints.person import Person2D, is_person_class
from mocap_ros.skeleton import detector_joint_names

FILE_SUFFIX = '_keypoints.json'  # end of the names of OpenPose's files
# Keys of a person's keypoints: of most detectors, of OpenPose since version 1.0 and before, and of CMU-Pose.
KEYPOINT_KEYS = ('keypoints', 'pose_keypoints_2d', 'pose_keypoints', 'joints')
MIN_PERSON_SCORE = 0.1  # people with a lower score are left out: COCO results hold many improbable people
MAX_STATED_TIME = 1e19  # in any unit; guards float(); a time in ns since 1970 has 1.8e18
VISIBLE = 2.0  # COCO's visibility of a joint that is seen; 1 is a joint that is labelled but hidden
CLASS_KEYS = ('name', 'class', 'class_name')  # keys of the class of a detection
ID_KEYS = ('track_id', 'tracker_id', 'idx', 'person_id')  # keys of the id that a tracker gives to a person
SCORE_KEYS = ('score', 'bbox_score', 'confidence')  # keys of the score of a person
LIST_KEYS = ('annotations', 'instance_info', 'predictions')  # keys of the list of people or frames
PEOPLE_KEYS = ('people', 'instances', 'bodies', 'instance_info', 'predictions')  # of the people of one frame
PERSON_CLASS, PERSON_ID = 'person', 1  # name and id of people among the categories of COCO
LANDMARK_KEYS = ('pose_landmarks', 'landmarks', 'pose_world_landmarks')  # of MediaPipe
EXPECTED_KEYPOINTS = 'keypoints: expected x, y, score of every joint'
EXPECTED_SIZE = 'expected width and height in px'


class _Entry(NamedTuple):
    """A person in an image: the image, and the place in the file with the content there."""

    image: ImageName
    place: str
    content: Any


class _Categories(NamedTuple):
    names: dict[Any, Names]
    general: Names = ()
    others: frozenset[Any] = frozenset()


@dataclass
class _Found:
    people: dict[ImageName, list[Person2D]] = field(default_factory=dict)
    # Entry, keypoints and the names of the joints of each person
    entries: list[tuple[_Entry, JsonKeypoints, Names]] = field(default_factory=list)
    times_s: dict[ImageName, float] = field(default_factory=dict)
    without_keypoints: int = 0  # number of detections without keypoints
    others: int = 0


def load_json_folder(folder: Path, options: ReadingOptions) -> Detections:
    """Load all people from a folder that holds a file for each frame; the names of the files order the frames.

    `options` give the frame rate, which is required unless the names are times, the image size, and the layout if
    it follows neither from names in the files nor from the number of keypoints.
    """
    paths = sorted(folder.glob(f'*{FILE_SUFFIX}')) or sorted(folder.glob('*.json'))
    if not paths:
        raise InputError(f'{folder}: no *.json in it')
    if len(paths) == 1 and not paths[0].name.endswith(FILE_SUFFIX) and not _is_frame(read_json(paths[0])):
        return load_json_file(paths[0], options)
    found = _Found()
    sizes = set[ImageSize]()  # px
    for path in paths:
        content = read_json(path)
        with naming(path):
            with naming('image', EXPECTED_SIZE):
                sizes |= _read_sizes([content])
            image = path.name.removesuffix(FILE_SUFFIX) if path.name.endswith(FILE_SUFFIX) else path.stem
            found.people[image] = []
            _add_time(found.times_s, image, content)
            _add_people(found, _iterate_people(image, '', content), _read_categories(content))
    with naming(folder):
        return _arrange(found, options, _choose_size(sizes))


def load_json_file(path: Path, options: ReadingOptions) -> Detections:
    """Load all people from a file, except people with a score below `MIN_PERSON_SCORE`.

    An image's `frame_id` is the number of its frame, else its file name or its id order it. `options` are as for
    `load_json_folder`; a size in the file overrides that of the images.
    """
    content = read_json(path)
    with naming(path):
        found = _Found()
        name_by_image, size = _read_images(content, found.times_s)
        found.people |= {name: [] for name in name_by_image.values()}
        _add_people(found, _iterate_entries(content, name_by_image, found), _read_categories(content))
        return _arrange(found, options, size)


def _arrange(found: _Found, options: ReadingOptions, size: ImageSize | None) -> Detections:
    """Return the people whose keypoints were read; the size in px is what the file states, None for nothing."""
    everybody = [keypoints for _, keypoints, _ in found.entries]
    labelled = [keypoints for keypoints in everybody if keypoints.labels]
    general = next((names for _, _, names in found.entries if names), ())
    placement = arrange_labels(labelled, options.layout, general) if labelled else None
    if placement and placement.size * len(labelled) > MAX_KEYPOINTS:
        people = f'{len(labelled)} people of {placement.size} joints'
        raise InputError(f'{people}, more than {MAX_KEYPOINTS} keypoints')
    factor = 1 / VISIBLE if _are_visibilities(everybody) else 1.0
    has_points = False
    for entry, keypoints, own_names in found.entries:
        values = keypoints.values
        names = own_names
        has_points = has_points or bool((values[:, :2] > 0).any())
        if placement and keypoints.labels:
            values = placement.place(keypoints)
            names = placement.joints
        with naming(entry.place):
            person = create_person(values * [1.0, 1.0, factor], options.layout, _read_id(entry.content), names)
        if (person.score > 0).any():
            found.people[entry.image].append(person)
    options = options._replace(image_size=resolve_image_size(stated=size, configured=options.image_size))
    detections = arrange_frames(found.people, options, found.times_s)
    if not any(found.people.values()):
        raise InputError(_describe_absence(found, has_points=has_points))
    unknown = [repr(key) for key in dict.fromkeys(key for keypoints in everybody for key in keypoints.unknown)]
    others = f'{found.others} detections that are no people are left out' if found.others else ''
    unused = f'not known and not used, beside the keypoints: {list_some(unknown)}' if unknown else ''
    return replace(detections, notes=(*detections.notes, *filter(None, (others, unused))))


def _describe_absence(found: _Found, *, has_points: bool) -> str:
    if has_points:
        return (
            'the score of every keypoint is 0, which means not seen; '
            'if the detector gives no scores, leave them out or write 1'
        )
    if found.without_keypoints and not found.entries:
        return (
            f'{found.without_keypoints} detections without keypoints, as of a model that finds boxes; '
            'run a model for poses, such as yolo11n-pose.pt'
        )
    if found.others and not found.entries:
        return 'all detections are of categories that are no people'
    return 'no person is seen in any frame'


def _find_key(content: Any, keys: Iterable[str]) -> str:
    """Return the first of the keys that content has, else an empty text."""
    return next((key for key in keys if key in content), '')


def _is_frame(content: Any) -> bool:
    if isinstance(content, dict):
        return not content.keys().isdisjoint(('people', 'bodies', 'instances'))
    return isinstance(content, list) and all(
        isinstance(p, dict) and _find_key(p, KEYPOINT_KEYS) and not {'image_id', 'frame_id'} & p.keys()
        for p in content
    )


def _iterate_people(image: ImageName, place: str, content: Any) -> Iterator[_Entry]:
    """Yield all people of a frame: those of a mapping that lists them, or of the list itself."""
    key = ''
    if isinstance(content, dict):
        _refuse_landmarks(content)
        key = _find_key(content, PEOPLE_KEYS)
        content = content.get(key)
    if not isinstance(content, list):
        raise InputError(f'{place}{": " if place else ""}no list of people; not a frame of OpenPose or MMPose')
    if len(content) == 1 and isinstance(content[0], list):  # `result['predictions']` of MMPoseInferencer
        (content,) = content
    place = '.'.join(filter(None, (place, key)))
    for index, person in enumerate(content):
        yield _Entry(image, f'{place}[{index}]', person)


def _iterate_entries(content: Any, name_by_image: Mapping[Any, ImageName], found: _Found) -> Iterator[_Entry]:
    """Yield all people in a file, and add all its frames and their times to those that were found."""
    key = ''
    if isinstance(content, dict):
        key = _find_key(content, LIST_KEYS)
        if not key:
            yield from _iterate_mapping(content, found.people)
            return
        content = content[key]
    if not isinstance(content, list):
        raise InputError('no COCO keypoints: expected a list')
    for index, entry in enumerate(content):
        place = f'{key}[{index}]'
        people: Any = None
        with naming(place, 'expected image_id and keypoints, or frame_id and instances'):
            if isinstance(entry, list):
                image = _parse_image_name(index)
                people = entry
            elif people_key := _find_key(entry, PEOPLE_KEYS):
                number = entry.get('frame_id')
                image = _parse_image_name(index if number is None else int(number))
                place = f'{place}.{people_key}'
                people = list(entry[people_key])
            else:
                _refuse_landmarks(entry)
                image = entry['image_id']
                image = name_by_image[image] if image in name_by_image else _parse_image_name(image)
        found.people.setdefault(image, [])
        _add_time(found.times_s, image, entry)
        if people is None:
            yield _Entry(image, place, entry)
        else:
            yield from _iterate_people(image, place, people)


def _iterate_mapping(content: dict[str, Any], frames: dict[ImageName, list[Person2D]]) -> Iterator[_Entry]:
    """Yield the people in a mapping without a list of frames, as AlphaPose and easy_ViTPose write it."""
    _refuse_landmarks(content)
    if content and all(isinstance(frame, dict) and _is_frame(frame) for frame in content.values()):
        for name, frame in content.items():
            frames.setdefault(name, [])
            yield from _iterate_people(name, repr(name), frame)
    elif isinstance(content.get('keypoints'), list):
        yield from _iterate_vitpose(content['keypoints'], frames)
    else:
        hint = '; one frame of OpenPose, give its folder' if 'people' in content else ''
        raise InputError(f'no COCO keypoints: neither annotations nor instance_info in it{hint}')


def _iterate_vitpose(content: list[Any], frames: dict[ImageName, list[Person2D]]) -> Iterator[_Entry]:
    """Yield the people in a file of easy_ViTPose, whose keypoints are y, x and the score."""
    for index, people in enumerate(content):
        frames.setdefault(index, [])
        with naming(f'keypoints[{index}]', 'expected the keypoints y, x, score of people by their ids'):
            entries = {
                person_id: np.array(keypoints, np.float64).reshape(-1, 3)[:, [1, 0, 2]].tolist()
                for person_id, keypoints in people.items()
            }
        for person_id, keypoints in entries.items():
            yield _Entry(index, f'keypoints[{index}].{person_id}', {'keypoints': keypoints, 'track_id': person_id})


def _add_people(found: _Found, entries: Iterable[_Entry], categories: _Categories) -> None:
    """Add the keypoints of probable people in images; other detections are counted."""
    entries = list(entries)
    ids = set()
    contents = [entry.content for entry in entries if isinstance(entry.content, dict)]
    has_people = any(_read_class(content, '') == PERSON_CLASS for content in contents)
    for entry in entries:
        if isinstance(entry.content, dict) and 'category_id' in entry.content:
            with naming(entry.place, 'category_id: expected a number or a name'):
                ids.add(entry.content['category_id'])
    others = categories.others or (ids - {PERSON_ID} if PERSON_ID in ids and not categories.names else set())
    for entry in entries:
        person = entry.content
        _refuse_landmarks(person[0] if isinstance(person, list) and person else person)
        if not isinstance(person, dict):
            raise InputError(f'{entry.place}: expected a person with keypoints')
        key = _find_key(person, KEYPOINT_KEYS)
        category = person.get('category_id')
        name = _read_class(person, PERSON_CLASS)
        if not is_person_class(name) or (has_people and name != PERSON_CLASS) or category in others:
            found.others += 1
        elif not key and 'people[' in entry.place:
            raise InputError(f'{entry.place}: no {KEYPOINT_KEYS[1]}')
        elif not key or _has_no_keypoints(person[key]):
            found.without_keypoints += 1
        else:
            score = person.get(_find_key(person, SCORE_KEYS), 1.0)
            if isinstance(score, (int, float)) and score < MIN_PERSON_SCORE:
                continue
            with naming(entry.place, EXPECTED_KEYPOINTS):
                keypoints = read_keypoints(person, key)
            names = categories.names.get(category) or categories.general
            found.entries.append((entry, keypoints, names))


def _read_class(person: Mapping[str, Any], default: str) -> str:
    return next((person[key] for key in CLASS_KEYS if isinstance(person.get(key), str)), default)


def _has_no_keypoints(raw: Any) -> bool:
    return raw is None or raw in ([], {}) or (isinstance(raw, dict) and raw.get('x') == [])


def _refuse_landmarks(entry: Any) -> None:
    """Raise InputError if an entry is a landmark of MediaPipe or holds a list of them."""
    if not isinstance(entry, dict):
        return
    is_landmark = {'x', 'y'} <= entry.keys() and not {'width', 'w', 'keypoints'} & entry.keys()
    if is_landmark or _find_key(entry, LANDMARK_KEYS):
        raise InputError(
            'landmarks of MediaPipe, whose x and y are shares of the width and height of the image; expected '
            'keypoints in px: write each person as {"image_id": frame, "keypoints": [x * width, y * height, '
            'visibility, ...]}'
        )


def _parse_image_name(name: Any) -> ImageName:
    """Return the name or the number of an image; TypeError or OverflowError where it can be none."""
    if isinstance(name, float):
        name = int(name) if name.is_integer() else repr(name)
    if isinstance(name, bool) or not isinstance(name, (int, str)):
        raise TypeError
    if isinstance(name, int) and abs(name) >= 10**19:
        raise OverflowError
    return str(name) if isinstance(name, int) and abs(name) >= MAX_FRAME_NUMBER else name


def _add_time(times_s: dict[ImageName, float], image: ImageName, content: Any) -> None:
    """Add the time of an image in s, if the content of a file states it there."""
    for key, seconds in SECONDS_BY_KEY.items() if isinstance(content, dict) else ():
        value = content.get(key)
        if isinstance(value, (int, float)) and 0 <= value < MAX_STATED_TIME:
            times_s[image] = float(value) * seconds


def _read_images(content: Any, times_s: dict[ImageName, float]) -> tuple[dict[Any, ImageName], ImageSize | None]:
    """Return the name of each image by the image's id, and the size in px, None where no image has one.

    Their times are added to `times_s`.
    """
    entries = content.get('images', []) if isinstance(content, dict) else []
    name_by_image: dict[Any, ImageName] = {}
    with naming('image', EXPECTED_SIZE):
        sizes = _read_sizes(content)
        names = set()
    with naming('images', 'expected a list'):
        entries = list(entries)
    for index, image in enumerate(entries):
        with naming(f'images[{index}]', 'expected id, file_name, width, height'):
            name = _parse_image_name(image.get('frame_id', image.get('file_name', image['id'])))
            sizes |= _read_sizes([{'image': image}])
            name_by_image[image['id']] = name
            _add_time(times_s, name, image)
            if name in names:
                raise InputError(f'a second image {name!r}; a file must hold one video')
            names.add(name)
    return name_by_image, _choose_size(sizes)


def _read_sizes(frames: Any) -> set[ImageSize]:
    """Return the sizes in px that a list of frames states of its images; one of `MALFORMED` where it is none."""
    images = [f.get('image') for f in frames if isinstance(f, dict)] if isinstance(frames, list) else []
    sizes = {(int(i['width']), int(i['height'])) for i in images if isinstance(i, dict) and 'width' in i}
    if sizes and min(map(min, sizes)) < 1:
        raise ValueError
    return sizes


def _choose_size(sizes: set[ImageSize]) -> ImageSize | None:
    if len(sizes) > 1:
        raise InputError('images: of different sizes; a file must hold one video')
    return next(iter(sizes), None)


def _are_visibilities(people: list[JsonKeypoints]) -> bool:
    """Return whether the scores of all keypoints are COCO's visibility (0, 1 or 2)."""
    scores = np.concatenate([np.zeros(0), *(keypoints.values[:, 2] for keypoints in people)])
    return bool(np.isin(scores, (0.0, 1.0, VISIBLE)).all() and (scores == VISIBLE).any())


def _read_categories(content: Any) -> _Categories:
    if not isinstance(content, dict):
        return _Categories({})
    entries = content.get('categories')
    categories = [c for c in entries if isinstance(c, dict)] if isinstance(entries, list) else []
    called = [c for c in categories if PERSON_CLASS in (c.get('name'), c.get('supercategory'))]
    people = called or [c for c in categories if is_person_class(c.get('name'))]
    with naming('categories', 'expected an id that is a number or a name'):
        others = frozenset(c.get('id') for c in categories if c not in people)
        names = {c.get('id'): _read_names(c.get('keypoints')) for c in people}
    general = _read_own_names(content) or _read_own_names(content.get('meta_info'))
    return _Categories(names, general or next(filter(None, names.values()), ()), others)


def _read_own_names(content: Any) -> Names:
    if not isinstance(content, dict):
        return ()
    return next(filter(None, (_read_names(content.get(key)) for key in NAME_KEYS)), ())


def _read_names(names: Any) -> Names:
    return detector_joint_names(list_names(names))


def _read_id(content: Mapping[str, Any]) -> str:
    value = content.get(_find_key(content, ID_KEYS))
    if 'person_id' in content and value is content['person_id']:  # of OpenPose, which writes [-1] without tracking
        is_id = isinstance(value, list) and len(value) == 1 and isinstance(value[0], int) and value[0] >= 0
        return str(value[0]) if is_id else ''
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value) if isinstance(value, (int, str)) else ''
