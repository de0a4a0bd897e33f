# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Functions that the readers of foreign messages share."""

from __future__ import annotations

from typing import Any

from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import Array, validate_person

# Guards the time of the decoder, which takes up to a second for so many bytes. A message of 20 people is below
# 100 kB, and the outline of each of them below 20 kB.
MAX_MESSAGE_BYTES = 4_000_000


def decode_foreign(raw: bytes, msgtype: str) -> Any:
    """Decode a foreign message that is not too large.

    Args:
        raw: CDR bytes.
        msgtype: name of the expected message type.

    Raises:
        InputError: the message is larger than `MAX_MESSAGE_BYTES`, or not of that type.
    """
    if len(raw) > MAX_MESSAGE_BYTES:
        raise InputError(f'{len(raw)} bytes, more than a {msgtype} may have ({MAX_MESSAGE_BYTES})')
    return decode(raw, msgtype)


def validate_person_of_field(
    person_id: str, joints: tuple[str, ...], points: Array, score: Array, image_width: int, field: str
) -> Person2D:
    """Validate the keypoints of a person, as `validate_person` does, with errors that name the message's field.

    Args:
        person_id: id given by the detector, or empty.
        joints: (J,) joint names.
        points: (J, 2) image points in px.
        score: (J,) confidence scores.
        image_width: width of the image in px, 0 where unknown.
        field: name of the field that holds the keypoints.

    Raises:
        InputError: a keypoint is not valid; the error names the field and the index of the joint.
    """
    try:
        return validate_person(person_id, joints, points, score, image_width)
    except InputError as error:
        raise InputError(f'{field}: {error}') from None
