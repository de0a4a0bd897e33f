"""hri_msgs/Skeleton2D and IdsList (ROS4HRI, REP-155)."""

from __future__ import annotations

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, checked_header, checked_text
from mocap_ros.messages.foreign.definitions import BODY, BODY_IDS
from mocap_ros.messages.foreign.shared import Size, _decoded, _person
from mocap_ros.messages.keypoints import check_count
from mocap_ros.skeleton import layout

HRI18 = layout('hri18').joints


def decode_body(raw: bytes, name: str, size: Size, limits: NodeConfig) -> tuple[Header, Person2D]:
    """The image and the person of a ROS4HRI Skeleton2D.

    Args:
        raw: CDR.
        name: of the body, from its topic.
        size: of the image in px, by which the shares of it are undone.
        limits: most text.

    Raises:
        InputError: names the field and the joint, or the size of the image is not known.
    """
    message = _decoded(raw, BODY)
    header = checked_header(message.header, limits)
    if not all(size):
        raise InputError(
            'skeleton: shares of an image whose size is not known: neither CameraInfo nor the parameters '
            'node.image_width and node.image_height say it'
        )
    shares = np.array([[p.x, p.y] for p in message.skeleton], np.float64)
    score = np.array([p.c for p in message.skeleton], np.float64)
    named = checked_text(name, 'id', limits)
    return header, _person(named, HRI18, shares * np.array(size), score, 0, 'skeleton')


def decode_ids(raw: bytes, limits: NodeConfig) -> tuple[Header, tuple[str, ...]]:
    """The image and the ids of a ROS4HRI IdsList.

    Raises:
        InputError: too many, or a long one.
    """
    message = _decoded(raw, BODY_IDS)
    check_count('ids', len(message.ids), limits)
    ids = tuple(checked_text(i, 'ids', limits) for i in message.ids)
    return checked_header(message.header, limits), ids
