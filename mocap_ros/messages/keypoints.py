"""mocap_ros_msgs/Keypoints2DArray: decoded and checked, and encoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import first_fault, looks_normalised, tidied
from mocap_ros.messages.cdr import OWN, Header, checked_header, checked_text, decode, encode, new, new_header
from mocap_ros.skeleton import LAYOUT_NAMES, joint_map, layout

Array = NDArray[np.float64]


KEYPOINTS = OWN + 'Keypoints2DArray'


@dataclass(frozen=True, eq=False)
class KeypointsFrame:
    """Everyone detected in one image.

    Attributes:
        header: of the image.
        image_width: px, 0 where unknown.
        image_height: px, 0 where unknown.
        people: in the order of the message.
    """

    header: Header
    image_width: int
    image_height: int
    people: tuple[Person2D, ...]


def decode_keypoints(raw: bytes, limits: NodeConfig) -> KeypointsFrame:
    """A checked Keypoints2DArray.

    Args:
        raw: CDR.
        limits: most people, joints and text that a message may hold.

    Raises:
        InputError: names the field, and the person where there is one.
    """
    _check_size(raw, limits)
    message = decode(raw, KEYPOINTS)
    header = checked_header(message.header, limits)
    check_count('people', len(message.people), limits)
    people = tuple(_person(p, i, message.image_width, limits) for i, p in enumerate(message.people))
    check_ids('people', people)
    return KeypointsFrame(header, message.image_width, message.image_height, people)


def check_count(field: str, count: int, limits: NodeConfig) -> None:
    """Refuse too many people.

    Raises:
        InputError: names the field.
    """
    if count > limits.max_people:
        raise InputError(f'{field}: {count}, more than {limits.max_people}')


def check_ids(field: str, people: Sequence[Person2D]) -> None:
    """Refuse an id that two people have.

    Raises:
        InputError: names the field and the id.
    """
    named = [p.id for p in people if p.id]
    if len(set(named)) != len(named):
        raise InputError(f'{field}: id {max(named, key=named.count)!r} twice')


def _check_size(raw: bytes, limits: NodeConfig) -> None:
    """Refuse, before anything is decoded, what no message within the limits can hold."""
    text = 4 * limits.max_text + 8
    person = 2 * text + limits.max_joints * (text + 12) + 64
    largest = 64 + text + limits.max_people * person
    if len(raw) > largest:
        raise InputError(f'{len(raw)} bytes, more than the limits allow ({largest})')


def _person(person: Any, index: int, image_width: int, limits: NodeConfig) -> Person2D:
    try:
        return _checked_person(person, image_width, limits)
    except InputError as error:
        raise InputError(f'people[{index}].{error}') from None


def _checked_person(person: Any, image_width: int, limits: NodeConfig) -> Person2D:
    lengths = {f: len(getattr(person, f)) for f in ('x', 'y', 'score')}
    if len(set(lengths.values())) > 1:
        raise InputError(f'x, y, score: unequal lengths {", ".join(map(str, lengths.values()))}')
    count = lengths['x']
    if count > limits.max_joints:
        raise InputError(f'x: {count} joints, more than {limits.max_joints}')
    joints = _joints(person, count, limits)
    points = np.stack([person.x, person.y], axis=-1).astype(np.float64)
    score = np.asarray(person.score, np.float64)
    return checked_person(checked_text(person.id, 'id', limits), joints, points, score, image_width)


def checked_person(name: str, joints: tuple[str, ...], points: Array, score: Array, image_width: int) -> Person2D:
    """A person whose keypoints have been looked at, wherever they come from.

    Args:
        name: the detector's, or empty.
        joints: (J,) names.
        points: (J, 2) px.
        score: (J,).
        image_width: px, 0 where unknown.

    Raises:
        InputError: names the field and the joint.
    """
    fault = first_fault(points, score)
    if fault:
        raise InputError(f'{fault.field}[{fault.index[0]}]: {fault.what}')
    points, score = tidied(points, score)
    if looks_normalised(points, score, image_width):
        raise InputError('x, y: looks normalised; px expected')
    return Person2D(name, joints, points, score)


def _joints(person: Any, count: int, limits: NodeConfig) -> tuple[str, ...]:
    """Names of the joints of a message's person."""
    name = checked_text(person.skeleton, 'skeleton', limits)
    if not name and not person.joint_names:
        raise InputError(f'skeleton: empty, and no joint_names; known: {", ".join(LAYOUT_NAMES)}')
    given = tuple(checked_text(n, 'joint_names', limits) for n in person.joint_names)
    field, named = ('joint_names', 'there are') if given else ('skeleton', f'{name!r} has')
    try:
        joints = given or layout(name).joints
        if len(joints) != count:
            raise InputError(f'{field}: {named} {len(joints)} joints, x has {count}')
        joint_map(joints)
    except SkeletonError as error:
        raise InputError(f'{field}: {error}') from None
    return joints


def encode_keypoints(header: Header, image_size: tuple[int, int], people: Sequence[Person2D]) -> bytes:
    """A Keypoints2DArray.

    Args:
        header: of the image.
        image_size: (width, height) px.
        people: their joints go by the name of a layout where they are one, else by their own names.
    """
    message = new(
        KEYPOINTS,
        header=new_header(header),
        image_width=image_size[0],
        image_height=image_size[1],
        people=[_new_person(p) for p in people],
    )
    return encode(message, KEYPOINTS)


def _new_person(person: Person2D) -> Any:
    name = next((n for n in LAYOUT_NAMES if layout(n).joints == person.joints), '')
    return new(
        OWN + 'Keypoints2D',
        id=person.id,
        skeleton=name,
        joint_names=[] if name else list(person.joints),
        x=person.points[:, 0].astype(np.float32),
        y=person.points[:, 1].astype(np.float32),
        score=person.score.astype(np.float32),
    )
