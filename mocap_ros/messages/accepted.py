"""Every message type that is accepted as keypoints, and its decoder."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import checked_header
from mocap_ros.messages.foreign.definitions import OPENPOSE, YOLO, ZED
from mocap_ros.messages.foreign.openpose import _of_openpose
from mocap_ros.messages.foreign.shared import Size, _decoded
from mocap_ros.messages.foreign.yolo import _of_yolo
from mocap_ros.messages.foreign.zed import _of_zed
from mocap_ros.messages.keypoints import KEYPOINTS, KeypointsFrame, check_count, check_ids, decode_keypoints

KEYPOINT_TYPES = (KEYPOINTS, YOLO, ZED, OPENPOSE)


def decode_frame(raw: bytes, msgtype: str, limits: NodeConfig, size: Size) -> KeypointsFrame:
    """Everyone in a message of any of the types that hold an image's people.

    Args:
        raw: CDR.
        msgtype: one of `messages.KEYPOINT_TYPES`.
        limits: most people, joints and text that a message may hold.
        size: of the image in px, (0, 0) where unknown.

    Raises:
        InputError: names the field, and the person where there is one.
    """
    if msgtype == KEYPOINTS:
        return decode_keypoints(raw, limits)
    field, people_of = _READERS[msgtype]
    message = _decoded(raw, msgtype)
    header = checked_header(message.header, limits)
    entries = getattr(message, field)
    check_count(field, len(entries), limits)
    people = []
    for index, entry in enumerate(entries):
        try:
            person = people_of(entry, size, limits)
        except InputError as error:
            raise InputError(f'{field}[{index}].{error}') from None
        if person is not None:
            people.append(person)
    check_ids(field, people)
    return KeypointsFrame(header, *size, tuple(people))


_READERS: dict[str, tuple[str, Callable[[Any, Size, NodeConfig], Person2D | None]]] = {
    YOLO: ('detections', _of_yolo),
    ZED: ('objects', _of_zed),
    OPENPOSE: ('pose_key_points_list', _of_openpose),
}
