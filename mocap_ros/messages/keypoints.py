# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Keypoints2DArray: the 2D keypoints of all people in an image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.arrays import Array, copy_as_float64
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError, naming
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import describe_other_unit, mark_unknown_depth, mark_unseen
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, decode_input, validate_header, validate_text
from mocap_ros.messages.plain import encode_plain
from mocap_ros.skeleton import LAYOUT_NAMES, keypoint_layout

KEYPOINTS = MOCAP_ROS_MSGS + 'Keypoints2DArray'


@dataclass(frozen=True, eq=False)
class KeypointsFrame:
    """The people in one image."""

    header: Header
    image_width: int  # px, 0 where unknown
    image_height: int  # px, 0 where unknown
    people: tuple[Person2D, ...]
    # Number of detections of people without keypoints; models that find boxes have no others
    without_keypoints: int = 0


def decode_keypoints(raw: bytes, limits: NodeConfig) -> KeypointsFrame:
    """Decode and validate a Keypoints2DArray."""
    message = decode_input(raw, KEYPOINTS)
    header = validate_header(message.header, limits)
    people = read_people('people', message.people, lambda p: _read_person(p, message.image_width, limits), limits)
    return KeypointsFrame(header, message.image_width, message.image_height, people)


def read_people(
    field: str, entries: Sequence[Any], read_person: Callable[[Any], Person2D | None], limits: NodeConfig
) -> tuple[Person2D, ...]:
    """Read the entries of the field that lists people; `read_person` returns None where an entry is no person."""
    if len(entries) > limits.max_people:
        raise InputError(f'{field}: {len(entries)}, more than {limits.max_people}')
    people = []
    for index, entry in enumerate(entries):
        try:
            person = read_person(entry)
        except InputError as error:
            raise InputError(f'{field}[{index}].{error}') from None
        if person is not None:
            people.append(person)
    check_ids(field, people)
    return tuple(people)


def check_ids(field: str, people: Sequence[Person2D]) -> None:
    """Raise InputError, which names the field and the id, if two people have the same id that is not empty."""
    ids = [p.id for p in people if p.id]
    if len(set(ids)) != len(ids):
        raise InputError(f'{field}: id {max(ids, key=ids.count)!r} twice')


def _read_person(person: Any, image_width: int, limits: NodeConfig) -> Person2D:
    lengths = len(person.x), len(person.y), len(person.score)
    if len(set(lengths)) > 1:
        raise InputError(f'x, y, score: unequal lengths {", ".join(map(str, lengths))}')
    if lengths[0] > limits.max_joints:
        raise InputError(f'x: {lengths[0]} joints, more than {limits.max_joints}')
    joints = _read_joint_names(person, lengths[0], limits)
    x, y, score = copy_as_float64((person.x, person.y, person.score))
    found = validate_person(
        validate_text(person.id, 'id', limits), joints, np.column_stack([x, y]), score, image_width
    )
    if len(person.depth) in (0, lengths[0]):
        return replace(found, depth=read_depth(person.depth)) if len(person.depth) else found
    raise InputError(f'depth: {len(person.depth)} values, x has {lengths[0]}')


def validate_person(
    person_id: str, joints: tuple[str, ...], points: Array, score: Array, image_width: int, field: str = ''
) -> Person2D:
    """Validate points (J, 2) in px and scores (J,) of any message type; unseen ones become NaN with score 0.

    `field` names the field that holds the keypoints; empty where x, y and score are fields themselves.
    """
    prefix = f'{field}: ' if field else ''
    points, score, fault = mark_unseen(points, score)
    if fault is not None:
        raise InputError(f'{prefix}{fault.field}[{fault.index[0]}]: {fault.what}')
    if other_unit := describe_other_unit(points, score, image_width):
        raise InputError(f'{prefix}x, y: {other_unit}')
    return Person2D(person_id, joints, points, score)


def read_depth(values: ArrayLike) -> Array | None:
    """Return depths (J,) in m, NaN where unknown; None if all are."""
    depth = mark_unknown_depth(np.asarray(values, np.float64))
    return None if np.isnan(depth).all() else depth


def _read_joint_names(person: Any, count: int, limits: NodeConfig) -> tuple[str, ...]:
    """Return the joint names of a person: `joint_names` where it is set, else the joints of the layout."""
    layout_name = validate_text(person.skeleton, 'skeleton', limits)
    if not layout_name and not person.joint_names:
        raise InputError(f'skeleton: empty, and no joint_names; known: {", ".join(LAYOUT_NAMES)}')
    joint_names = tuple(validate_text(n, 'joint_names', limits) for n in person.joint_names)
    field, subject = ('joint_names', 'there are') if joint_names else ('skeleton', f'{layout_name!r} has')
    with naming(field):
        joints = joint_names or _find_layout_joints(layout_name)
        if len(joints) != count:
            raise InputError(f'{subject} {len(joints)} joints, x has {count}')
        if joint_names:
            build_joint_map(joints)
    return joints


@lru_cache(maxsize=len(LAYOUT_NAMES))
def _find_layout_joints(layout_name: str) -> tuple[str, ...]:
    joints = keypoint_layout(layout_name).joints
    build_joint_map(joints)
    return joints


def encode_keypoints(header: Header, image_size: tuple[int, int], people: Sequence[Person2D]) -> bytes:
    """Encode people in an image of a size (width, height) in px as a Keypoints2DArray.

    Joints that are those of a layout are given by its name, others by their names.
    """
    entries = []
    for person in people:
        layout_name = next((n for n in LAYOUT_NAMES if keypoint_layout(n).joints == person.joints), '')
        names = () if layout_name else person.joints
        depth = () if person.depth is None else person.depth
        entries.append((person.id, layout_name, names, *person.points.T, person.score, depth))
    message = {'header': header, 'image_width': image_size[0], 'image_height': image_size[1], 'people': entries}
    return encode_plain(message, KEYPOINTS)
