# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Keypoints2DArray: the 2D keypoints of all people in an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import NodeConfig
from mocap_ros.copying import copy_as_float64
from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import (
    NORMALISED_RANGE,
    find_first_fault,
    looks_normalised,
    mark_unseen,
)
from mocap_ros.messages.cdr import (
    MOCAP_ROS_MSGS,
    Header,
    create_header,
    create_message,
    decode,
    encode,
    read_count,
    validate_header,
    validate_text,
)
from mocap_ros.skeleton import LAYOUT_NAMES, keypoint_layout

Array = NDArray[np.float64]

KEYPOINTS = MOCAP_ROS_MSGS + 'Keypoints2DArray'

SKIPPED_FIELDS = 2  # fields between the header and the people: width and height of the image
MAX_UTF8_BYTES = 4  # bytes of one character
STRING_OVERHEAD_BYTES = 8  # the length (4), the terminating zero (1) and the alignment (3) of a CDR string
JOINT_BYTES = 12  # x, y and score as float32
FIXED_FIELDS_BYTES = 64  # guard: more than the lengths, numbers and alignment of a header or of one person


@dataclass(frozen=True, eq=False)
class KeypointsFrame:
    """The keypoints of all people detected in one image.

    Attributes:
        header: time and frame of the image.
        image_width: width of the image in px, 0 where unknown.
        image_height: height of the image in px, 0 where unknown.
        people: the people in the order of the message.
    """

    header: Header
    image_width: int
    image_height: int
    people: tuple[Person2D, ...]


def decode_keypoints(raw: bytes, limits: NodeConfig) -> KeypointsFrame:
    """Decode and validate a Keypoints2DArray.

    Args:
        raw: CDR bytes.
        limits: the parameters that limit the number of people, the number of joints and the length of texts.

    Raises:
        InputError: the message is not valid; the error names the field, and the person if the fault is in one.
    """
    _check_message_length(raw, limits)
    check_count('people', read_count(raw, SKIPPED_FIELDS), limits)
    message = decode(raw, KEYPOINTS)
    header = validate_header(message.header, limits)
    people = _read_people(message.people, message.image_width, limits)
    check_ids('people', people)
    return KeypointsFrame(header, message.image_width, message.image_height, people)


def check_count(field: str, count: int, limits: NodeConfig) -> None:
    """Check that a message does not hold too many people.

    Raises:
        InputError: `count` exceeds `limits.max_people`; the error names the field.
    """
    if count > limits.max_people:
        raise InputError(f'{field}: {count}, more than {limits.max_people}')


def check_ids(field: str, people: Sequence[Person2D]) -> None:
    """Check that no two people have the same id; empty ids may repeat.

    Raises:
        InputError: an id occurs twice; the error names the field and the id.
    """
    ids = [p.id for p in people if p.id]
    if len(set(ids)) != len(ids):
        raise InputError(f'{field}: id {max(ids, key=ids.count)!r} twice')


def _check_message_length(raw: bytes, limits: NodeConfig) -> None:
    """Refuse, before decoding, a message that is longer than any message within the limits."""
    text = MAX_UTF8_BYTES * limits.max_text + STRING_OVERHEAD_BYTES
    person = 2 * text + limits.max_joints * (text + JOINT_BYTES) + FIXED_FIELDS_BYTES
    max_bytes = FIXED_FIELDS_BYTES + text + limits.max_people * person
    if len(raw) > max_bytes:
        raise InputError(f'{len(raw)} bytes, more than the limits allow ({max_bytes})')


def _read_people(entries: Sequence[Any], image_width: int, limits: NodeConfig) -> tuple[Person2D, ...]:
    """Validate the people of a message; errors name the index of the person."""
    names = [_read_names(entry, index, limits) for index, entry in enumerate(entries)]
    people: list[Person2D] = []
    for _, equally_long in groupby(entries, lambda entry: len(entry.x)):  # mostly all of them
        numbers = copy_as_float64([(entry.x, entry.y, entry.score) for entry in equally_long])
        points, score = _check_and_mark(
            np.ascontiguousarray(numbers[:, :2].swapaxes(1, 2)), numbers[:, 2], image_width, len(people)
        )
        own_names = names[len(people) : len(people) + len(numbers)]
        people += [Person2D(*n, *arrays) for n, *arrays in zip(own_names, points, score, strict=True)]
    return tuple(people)


def _read_names(person: Any, index: int, limits: NodeConfig) -> tuple[str, tuple[str, ...]]:
    """Return the id and the joint names of a person whose arrays are of one length."""
    try:
        lengths = len(person.x), len(person.y), len(person.score)
        if len(set(lengths)) > 1:
            raise InputError(f'x, y, score: unequal lengths {", ".join(map(str, lengths))}')
        if lengths[0] > limits.max_joints:
            raise InputError(f'x: {lengths[0]} joints, more than {limits.max_joints}')
        joints = _read_joint_names(person, lengths[0], limits)
        return validate_text(person.id, 'id', limits), joints
    except InputError as error:
        raise InputError(f'people[{index}].{error}') from None


def validate_person(
    person_id: str, joints: tuple[str, ...], points: Array, score: Array, image_width: int
) -> Person2D:
    """Validate the keypoints of a person from any message type.

    Args:
        person_id: id given by the detector, or empty.
        joints: (J,) joint names.
        points: (J, 2) image points in px.
        score: (J,) confidence scores.
        image_width: width of the image in px, 0 where unknown.

    Returns:
        The person, in which unseen keypoints have NaN points and score 0.

    Raises:
        InputError: a keypoint is not valid; the error names the field and the index of the joint.
    """
    points, score = _check_and_mark(points[None], score[None], image_width)
    return Person2D(person_id, joints, points[0], score[0])


def _check_and_mark(
    points: Array, score: Array, image_width: int, first: int | None = None
) -> tuple[Array, Array]:
    """Validate the keypoints of several people, and mark those that were not seen.

    Args:
        points: (N, J, 2) image points in px.
        score: (N, J) confidence scores.
        image_width: width of the image in px, 0 where unknown.
        first: index in the message of the first of these people; None where errors need not name the person.

    Returns:
        Points and scores, in which unseen keypoints have NaN points and score 0.

    Raises:
        InputError: a keypoint is not valid; the error names the person, the field and the index of the joint.
    """

    def name(index: int) -> str:
        return '' if first is None else f'people[{first + index}].'

    fault = find_first_fault(points, score)
    if fault is not None:
        person, joint = fault.index
        raise InputError(f'{name(person)}{fault.field}[{joint}]: {fault.what}')
    points, score = mark_unseen(points, score)
    may_be_normalised = np.fmax.reduce(points, axis=(1, 2)) <= NORMALISED_RANGE[1]
    for index in np.flatnonzero(may_be_normalised).tolist():
        if looks_normalised(points[index], score[index], image_width):
            raise InputError(f'{name(index)}x, y: looks normalised; px expected')
    return points, score


def _read_joint_names(person: Any, count: int, limits: NodeConfig) -> tuple[str, ...]:
    """Return the joint names of a person: `joint_names` where it is set, else the joints of the layout."""
    layout_name = validate_text(person.skeleton, 'skeleton', limits)
    if not layout_name and not person.joint_names:
        raise InputError(f'skeleton: empty, and no joint_names; known: {", ".join(LAYOUT_NAMES)}')
    joint_names = tuple(validate_text(n, 'joint_names', limits) for n in person.joint_names)
    field, subject = ('joint_names', 'there are') if joint_names else ('skeleton', f'{layout_name!r} has')
    try:
        joints = joint_names or _find_layout_joints(layout_name)
        if len(joints) != count:
            raise InputError(f'{field}: {subject} {len(joints)} joints, x has {count}')
        if joint_names:
            build_joint_map(joints)
    except SkeletonError as error:
        raise InputError(f'{field}: {error}') from None
    return joints


@lru_cache(maxsize=len(LAYOUT_NAMES))
def _find_layout_joints(layout_name: str) -> tuple[str, ...]:
    """Return the joint names of a layout that has enough of the model's joints.

    Raises:
        SkeletonError: there is no such layout.
    """
    joints = keypoint_layout(layout_name).joints
    build_joint_map(joints)
    return joints


def encode_keypoints(header: Header, image_size: tuple[int, int], people: Sequence[Person2D]) -> bytes:
    """Encode people as a Keypoints2DArray.

    Args:
        header: time and frame of the image.
        image_size: (width, height) in px.
        people: the people in the image. If the joints of a person are those of a layout, the message holds the
            layout's name, else it holds the joint names.
    """
    message = create_message(
        KEYPOINTS,
        header=create_header(header),
        image_width=image_size[0],
        image_height=image_size[1],
        people=[_create_person(p) for p in people],
    )
    return encode(message, KEYPOINTS)


def _create_person(person: Person2D) -> Any:
    layout_name = next((n for n in LAYOUT_NAMES if keypoint_layout(n).joints == person.joints), '')
    return create_message(
        MOCAP_ROS_MSGS + 'Keypoints2D',
        id=person.id,
        skeleton=layout_name,
        joint_names=[] if layout_name else list(person.joints),
        x=person.points[:, 0].astype(np.float32),
        y=person.points[:, 1].astype(np.float32),
        score=person.score.astype(np.float32),
    )
