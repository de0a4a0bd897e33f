# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""hri_msgs/Skeleton2D and hri_msgs/IdsList of ROS4HRI (REP-155).

ROS4HRI publishes the ids of all tracked bodies on one topic, and each body on a topic of its own.
"""

from __future__ import annotations

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, decode_input, validate_header, validate_text
from mocap_ros.messages.foreign.definitions import HRI_IDS, HRI_SKELETON
from mocap_ros.messages.keypoints import validate_person
from mocap_ros.skeleton import keypoint_layout

HRI18 = keypoint_layout('hri18').joints  # joints in the order of hri_msgs/Skeleton2D


def decode_body(raw: bytes, body_id: str, size: ImageSize, limits: NodeConfig) -> tuple[Header, Person2D]:
    """Decode a Skeleton2D: the header of the image, and the person.

    Args:
        raw: CDR bytes.
        body_id: id of the body, from the name of its topic.
        size: size of the image, by which the normalised coordinates are multiplied.
        limits: the parameters that limit the length of a text.

    Raises:
        InputError: the message is not valid, or the size of the image is unknown; the error names the field.
    """
    message = decode_input(raw, HRI_SKELETON)
    header = validate_header(message.header, limits)
    if not all(size):
        raise InputError(
            'skeleton: coordinates are normalised, and the size of the image is unknown: neither CameraInfo nor '
            'the parameters node.image_width and node.image_height give it'
        )
    numbers = np.array([(p.x, p.y, p.c) for p in message.skeleton], np.float64)
    person_id = validate_text(body_id, 'id', limits)
    return header, validate_person(person_id, HRI18, numbers[:, :2] * size, numbers[:, 2], 0, 'skeleton')


def decode_ids(raw: bytes, limits: NodeConfig) -> tuple[Header, tuple[str, ...]]:
    """Decode an IdsList: the header of the image, and the ids of all bodies that are tracked in it.

    Raises:
        InputError: the message is not valid, there are too many ids, or an id is too long.
    """
    message = decode_input(raw, HRI_IDS)
    if len(message.ids) > limits.max_people:
        raise InputError(f'ids: {len(message.ids)}, more than {limits.max_people}')
    ids = tuple(validate_text(i, 'ids', limits) for i in message.ids)
    return validate_header(message.header, limits), ids
