# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints of a person in the JSON of a detector: their places, their scores, and which joints they are.

Places are x, y and perhaps the score of one keypoint after the other, a list of them for each keypoint, columns
{x, y}, or mappings {x, y}, which are in a list or have the names of the joints as keys. What else is known of a
keypoint is in these mappings or in columns beside the places: its score, and a label that says which joint it is,
by its name or its index. Keypoints without labels are in the order of a layout.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.skeleton import (
    KEYPOINT_LAYOUTS,
    KNOWN_JOINTS,
    MIN_LIKENESS,
    canonical_joint_names,
    detector_joint_names,
    keypoint_layout,
)

Names = tuple[str, ...]  # of joints, in the order of the keypoints; empty where they are not known

# Parts of the keys of scores; of several columns, the first in this order counts.
SCORE_PARTS = ('score', 'conf', 'prob', 'likelihood', 'accuracy', 'visib')
# Keys of the names of the joints: in any mapping, in the `meta_info` of MMPose, and of easy_ViTPose
NAME_KEYS = (
    'keypoint_names', 'joint_names', 'keypoint_id2name', 'keypoint_name2id', 'keypoint_info', 'skeleton',
)  # fmt: skip
# Keys of the name of a keypoint's joint, without case and separators: of TensorFlow.js, Roboflow and others
LABEL_KEYS = (
    'name', 'names', 'class', 'classname', 'label', 'labels', 'part', 'joint', 'bodypart', 'keypoint', 'type',
)  # fmt: skip
INDEX_KEY = 'labels'  # of the indices of the joints, of Hugging Face's ViTPose
MAX_JOINTS = 1000  # of all people of a file; guards the memory, and layouts have at most some hundreds
USUAL_COUNT = 17  # keypoints of ViTPose, of which people may have some only, with their indices
# Words of keys that say nothing about the keypoints: of boxes, people, images and other parts of the body
OTHER_WORDS = frozenset((
    'x', 'y', 'z', 'w', 'h', 'width', 'height', 'left', 'top', 'bbox', 'bboxes', 'box', 'boxes', 'rect', 'roi',
    'xywh', 'xyxy', 'center', 'centre', 'scale', 'area', 'segmentation', 'segments', 'mask', 'masks', 'polygon',
    'id', 'ids', 'idx', 'index', 'uuid', 'track', 'tracker', 'tracking', 'person', 'class', 'cls', 'category',
    'label', 'labels', 'name', 'names', 'type', 'image', 'img', 'file', 'frame', 'camera', 'time', 'timestamp',
    'num', 'count', 'crowd', 'iscrowd', 'ignore', 'face', 'hand', 'hands', 'foot', 'feet', 'world', '3d',
    'position', 'presence', 'skeleton', 'color', 'attributes', 'version', 'date',
))  # fmt: skip
MAX_CACHED_WORDS = 4096  # keys and names; guards the memory against files in which each is another


class JsonKeypoints(NamedTuple):
    """The keypoints of a person."""

    values: Array  # (J, 3) x and y in px, and the score
    labels: tuple[str | int, ...] = ()  # (J,) name or index of each joint; empty without labels
    unknown: tuple[str, ...] = ()  # keys beside the keypoints that are not understood


class Placement(NamedTuple):
    """Where keypoints with labels are put, so that all people have the same joints."""

    joints: Names  # empty where their number says which they are
    size: int  # number of joints
    column_by_label: dict[str | int, int]

    def place(self, keypoints: JsonKeypoints) -> Array:
        """Return x, y and score (`size`, 3) of all joints; NaN and score 0 of those that are missing."""
        placed = np.full((self.size, 3), [np.nan, np.nan, 0.0])
        for label, row in zip(keypoints.labels, keypoints.values, strict=True):
            if label in self.column_by_label:
                placed[self.column_by_label[label]] = row
        return placed


def read_keypoints(person: Mapping[str, Any], key: str) -> JsonKeypoints:
    """Read the keypoints that a person has as `key`; one of `MALFORMED` where the content has another shape."""
    raw = person[key]
    columns = dict[str, Any]()
    if isinstance(raw, dict) and 'x' not in raw:
        raw = [{**_name_numbers(point), 'name': name} for name, point in raw.items()]
    if isinstance(raw, dict):
        columns = raw
    elif isinstance(raw, list) and raw and isinstance(raw[0], dict):
        points = [{**point, **point.get('position', {})} for point in raw]
        columns = {name: [point.get(name) for point in points] for name in {k: None for p in points for k in p}}
    values = np.array([columns['x'], columns['y']] if columns else raw, np.float64)
    values = values.T if columns else values
    beside = {name: value for name, value in {**person, **columns}.items() if name != key}
    if values.ndim == 1:
        has_pairs = len(values) % 2 == 0 and _find_scores(beside, len(values) // 2)
        values = values.reshape(-1, 2 if has_pairs else 3)
    if values.ndim != 2 or values.shape[1] not in (2, 3, 4):
        raise ValueError
    used_for_score = _find_scores(beside, len(values))
    values = _add_scores(values, beside[used_for_score] if used_for_score else None)
    used_for_labels, labels = _find_labels(beside, len(values))
    used = {used_for_score, used_for_labels}
    count = 0 if labels else len(values)
    unknown = tuple(k for k, value in beside.items() if k not in used and not _says_nothing(k, value, count))
    named = [i for i, label in enumerate(labels) if label != '']  # Roboflow fills lists up without names
    return JsonKeypoints(values[named] if labels else values, tuple(labels[i] for i in named), unknown)


def _name_numbers(point: Any) -> Mapping[str, Any]:
    return point if isinstance(point, dict) else dict(zip(('x', 'y', 'score'), point, strict=False))


def _is_column(value: Any, count: int, *kinds: type) -> bool:
    return isinstance(value, list) and len(value) == count > 0 and all(isinstance(item, kinds) for item in value)


def _find_scores(beside: Mapping[str, Any], count: int) -> str:
    keys = [k for k in beside if rank_score(k) >= 0 and _is_column(beside[k], count, int, float, type(None))]
    return min(keys, key=rank_score, default='')


@lru_cache(MAX_CACHED_WORDS)
def rank_score(key: str) -> int:
    """Return the place of a key among those of scores, -1 if it is no such key."""
    return next((rank for rank, part in enumerate(SCORE_PARTS) if part in key.lower()), -1)


def _add_scores(values: Array, scores: list[Any] | None) -> Array:
    """Return x, y and score (J, 3); `values` may have the score, or a visibility that is 0 of what is not seen."""
    if values.shape[1] == 3 and scores is None:
        return values
    own = np.ones(len(values)) if scores is None else np.array(scores, np.float64)
    if values.shape[1] == 2:
        return np.column_stack([values, own])
    if values.shape[1] == 4 or not (np.isin(values[:, 2], (0, 1, 2)).all() or np.allclose(values[:, 2], own)):
        raise InputError(
            'keypoints: x, y, z of 3D joints, as MMPose human3d writes them; expected 2D keypoints in px: '
            'give the output of a 2D pose estimator'
        )
    return np.column_stack([values[:, :2], np.where(values[:, 2] > 0, own, 0.0)])


def _find_labels(beside: Mapping[str, Any], count: int) -> tuple[str, tuple[str | int, ...]]:
    """Return the key and the labels of `count` keypoints; nothing if they have none that name joints."""
    for key in NAME_KEYS:
        if names := list_names(beside.get(key)):
            if len(names) != count:
                raise InputError(f'{count} keypoints, but names of {len(names)}')
            return key, tuple(names)
    key_by_word = {''.join(_split_words(key)): key for key in beside}
    for key in (key_by_word[word] for word in LABEL_KEYS if word in key_by_word):
        if _is_column(beside[key], count, str) and any(map(_is_joint, beside[key])):
            _refuse_repeated(beside[key])
            return key, tuple(beside[key])
    indices = beside.get(INDEX_KEY, [])
    if _is_column(indices, count, int) and len({i for i in indices if 0 <= i < MAX_JOINTS}) == count:
        return INDEX_KEY, tuple(indices)
    return '', ()


def _refuse_repeated(names: list[str]) -> None:
    named = [name for name in names if name]
    if len(set(named)) < len(named):
        raise InputError(f'keypoints: two are called {max(named, key=named.count)!r}')


@lru_cache(MAX_CACHED_WORDS)
def _is_joint(name: str) -> bool:
    return canonical_joint_names([name])[0] in KNOWN_JOINTS


@lru_cache(MAX_CACHED_WORDS)
def _split_words(key: str) -> tuple[str, ...]:
    return tuple(word.lower() for word in re.findall('3[dD]|[A-Z]?[a-z]+|[A-Z]+', key))


def _says_nothing(key: str, value: Any, count: int) -> bool:
    """Return whether what is beside keypoints, `count` of them without labels, says nothing about them."""
    if _is_column(value, count, str) or (rank_score(key) >= 0 and isinstance(value, list) and len(value) > 1):
        return False
    return rank_score(key) >= 0 or _is_joint(key) or not OTHER_WORDS.isdisjoint(_split_words(key))


def list_names(names: Any) -> list[str]:
    """Return the names of joints that are listed, or mapped from their indices; empty if these are no names."""
    if isinstance(names, dict):
        with naming('names of the keypoints', 'expected a name for each index'):
            if all(isinstance(index, int) for index in names.values()):  # keypoint_name2id
                names = dict(zip(names.values(), names, strict=True))
            names = [names[key] for key in sorted(names, key=int)]
            names = [name['name'] if isinstance(name, dict) else name for name in names]  # keypoint_info
    return names if isinstance(names, list) and all(isinstance(name, str) for name in names) else []


def arrange_labels(people: Sequence[JsonKeypoints], layout: str, general: Names) -> Placement:
    """Return where the keypoints of people go whose keypoints have labels.

    The joints are those of the layout, if one is given; else those that are named, in the order of the layout that
    has them all, if most of its joints are named. Without names they are `general`, if known.
    """
    labels = dict.fromkeys(label for keypoints in people for label in keypoints.labels)
    if len(labels) > MAX_JOINTS:
        raise InputError(f'keypoints with {len(labels)} names, at most {MAX_JOINTS} expected')
    named = [label for label in labels if isinstance(label, str)]
    indices = [label for label in labels if isinstance(label, int)]
    joint_by_name = dict(zip(named, detector_joint_names(named), strict=True))
    joints = keypoint_layout(layout).joints if layout else general
    if named and not layout:
        given = dict.fromkeys(joint_by_name.values())
        layouts = [s.joints for s in KEYPOINT_LAYOUTS.values() if given.keys() <= set(s.joints)]
        fitting = [joints for joints in layouts if len(given) >= MIN_LIKENESS * len(joints)]
        joints = min(fitting, key=len, default=tuple(given))
    size = len(joints) or max(indices) + 1
    if not joints and any(len(keypoints.labels) < size for keypoints in people):
        size = max(size, USUAL_COUNT)
    columns: dict[str | int, int] = {i: i for i in indices if i < size}
    columns |= {name: joints.index(joint) for name, joint in joint_by_name.items() if joint in joints}
    return Placement(joints, size, columns)
