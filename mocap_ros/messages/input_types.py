# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The message types that are accepted as keypoints, and the decoder of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import read_count, validate_header
from mocap_ros.messages.foreign.definitions import OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.foreign.openpose import read_pose
from mocap_ros.messages.foreign.shared import decode_foreign
from mocap_ros.messages.foreign.yolo import read_detection
from mocap_ros.messages.foreign.zed import read_object
from mocap_ros.messages.keypoints import KEYPOINTS, KeypointsFrame, check_count, check_ids, decode_keypoints

# Types whose messages hold all people of an image. ROS4HRI is not among them: it sends a message for each person.
KEYPOINT_TYPES = (KEYPOINTS, YOLO_DETECTIONS, ZED_OBJECTS, OPENPOSE_POSES)


class _ForeignReader(NamedTuple):
    """How the people of a foreign message are read.

    Attributes:
        field: name of the field that lists the people.
        read_person: function that reads an entry of that field; it returns None where the entry is not a person.
    """

    field: str
    read_person: Callable[[Any, ImageSize, NodeConfig], Person2D | None]


_FOREIGN_READERS = {
    YOLO_DETECTIONS: _ForeignReader('detections', read_detection),
    ZED_OBJECTS: _ForeignReader('objects', read_object),
    OPENPOSE_POSES: _ForeignReader('pose_key_points_list', read_pose),
}


def decode_frame(raw: bytes, msgtype: str, limits: NodeConfig, size: ImageSize) -> KeypointsFrame:
    """Decode and validate a message of any type that holds all people of an image.

    Args:
        raw: CDR bytes.
        msgtype: one of `KEYPOINT_TYPES`.
        limits: the parameters that limit the number of people, the number of joints and the length of texts.
        size: (width, height) of the image in px, (0, 0) where unknown; a Keypoints2DArray gives its own.

    Raises:
        InputError: the message is not valid; the error names the field, and the person if the fault is in one.
    """
    if msgtype == KEYPOINTS:
        return decode_keypoints(raw, limits)
    field, read_person = _FOREIGN_READERS[msgtype]
    check_count(field, read_count(raw), limits)
    message = decode_foreign(raw, msgtype)
    header = validate_header(message.header, limits)
    people = []
    for index, entry in enumerate(getattr(message, field)):
        try:
            person = read_person(entry, size, limits)
        except InputError as error:
            raise InputError(f'{field}[{index}].{error}') from None
        if person is not None:
            people.append(person)
    check_ids(field, people)
    return KeypointsFrame(header, *size, tuple(people))
