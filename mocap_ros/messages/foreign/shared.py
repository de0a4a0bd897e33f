"""What the readers of foreign messages share."""

from __future__ import annotations

from typing import Any

from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import Array, checked_person

LARGEST_MESSAGE = 16_000_000


Size = tuple[int, int]


def _decoded(raw: bytes, msgtype: str) -> Any:
    if len(raw) > LARGEST_MESSAGE:
        raise InputError(f'{len(raw)} bytes, more than a {msgtype} may have ({LARGEST_MESSAGE})')
    return decode(raw, msgtype)


def _person(
    name: str, joints: tuple[str, ...], points: Array, score: Array, image_width: int, field: str
) -> Person2D:
    try:
        return checked_person(name, joints, points, score, image_width)
    except InputError as error:
        raise InputError(f'{field}: {error}') from None
