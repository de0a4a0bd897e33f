"""Keypoints of other people's detectors, checked as our own are; the same code live and in replay.

What they trap one with is dealt with here: sparse ids that begin at 1 (YOLO), shares of the image and one topic a
body (ROS4HRI), 70 places of which 18, 34 or 38 may be all that is used, and scores that only later versions have
(ZED), zeros for what was not seen (OpenPose).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.io.foreign_types import BODY, BODY_IDS, OPENPOSE, YOLO, ZED
from mocap_ros.io.messages import (
    KEYPOINTS,
    Array,
    Header,
    KeypointsFrame,
    check_count,
    check_ids,
    checked_header,
    checked_person,
    checked_text,
    decode,
    decode_keypoints,
)
from mocap_ros.people import Person2D
from mocap_ros.skeleton import layout

COCO17, COCO18, HRI18, BODY25 = (layout(n).joints for n in ('coco17', 'coco18', 'hri18', 'body25'))
OPENPOSE_LAYOUTS = {len(joints): joints for joints in (COCO17, COCO18, BODY25)}
LARGEST_MESSAGE = 16_000_000
PERCENT = 100

ZED34 = {
    'lshoulder': 5, 'lelbow': 6, 'lwrist': 7, 'rshoulder': 12, 'relbow': 13, 'rwrist': 14,
    'lhip': 18, 'lknee': 19, 'lankle': 20, 'rhip': 22, 'rknee': 23, 'rankle': 24,
    'nose': 27, 'leye': 28, 'lear': 29, 'reye': 30, 'rear': 31,
}  # fmt: skip
ZED38 = {
    'nose': 5, 'leye': 6, 'reye': 7, 'lear': 8, 'rear': 9, 'lshoulder': 12, 'rshoulder': 13,
    'lelbow': 14, 'relbow': 15, 'lwrist': 16, 'rwrist': 17, 'lhip': 18, 'rhip': 19,
    'lknee': 20, 'rknee': 21, 'lankle': 22, 'rankle': 23,
}  # fmt: skip
ZED_FORMATS = ({joint: i for i, joint in enumerate(COCO18)}, ZED34, ZED38, ZED38)  # of 18, 34, 38, 70 joints

Size = tuple[int, int]


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


def _of_yolo(detection: Any, size: Size, limits: NodeConfig) -> Person2D | None:
    """Only what the detector believes in is there, and says by an id from 1 which joint of COCO it is."""
    found = detection.keypoints.data
    if not found:
        return None
    points, score = np.full((len(COCO17), 2), np.nan), np.zeros(len(COCO17))
    for i, keypoint in enumerate(found):
        joint = keypoint.id - 1
        if not 0 <= joint < len(COCO17):
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id}, expected 1 to {len(COCO17)}')
        if np.isfinite(points[joint]).any():
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id} twice')
        points[joint] = keypoint.point.x, keypoint.point.y
        score[joint] = keypoint.score
    return _person(checked_text(detection.id, 'id', limits), COCO17, points, score, size[0], 'keypoints')


def _of_zed(body: Any, size: Size, _: NodeConfig) -> Person2D | None:
    """Where keypoints have no scores, that of the whole body stands for them. Not seen: NaN, negative or zero."""
    if not body.skeleton_available:
        return None
    if not 0 <= body.body_format < len(ZED_FORMATS):
        raise InputError(f'body_format: {body.body_format}, expected 0 to {len(ZED_FORMATS) - 1}')
    places = ZED_FORMATS[body.body_format]
    points = np.array([body.skeleton_2d.keypoints[i].kp for i in places.values()], np.float64)
    seen = np.isfinite(points).all(axis=1) & (points >= 0).all(axis=1) & (points != 0).any(axis=1)
    if not 0 <= body.confidence <= PERCENT:
        raise InputError(f'confidence: {body.confidence:g}, expected 0 to {PERCENT}')
    score = np.asarray(body.skeleton_keypoint_confidence, np.float64)[list(places.values())] / PERCENT
    if not (score > 0).any():
        score = np.full(len(places), body.confidence / PERCENT)
    points = np.where(np.isinf(points), np.nan, points)
    name = str(body.label_id) if body.tracking_available and body.label_id >= 0 else ''
    return _person(name, tuple(places), points, np.where(seen, score, 0.0), size[0], 'skeleton_2d.keypoints')


def _of_openpose(body: Any, size: Size, _: NodeConfig) -> Person2D | None:
    found = body.pose_key_points
    if len(found) not in OPENPOSE_LAYOUTS:
        known = ', '.join(map(str, OPENPOSE_LAYOUTS))
        raise InputError(f'pose_key_points: {len(found)} joints, expected {known}')
    points = np.array([[p.x, p.y] for p in found], np.float64)
    score = np.array([p.score for p in found], np.float64)
    return _person('', OPENPOSE_LAYOUTS[len(found)], points, score, size[0], 'pose_key_points')


_READERS: dict[str, tuple[str, Callable[[Any, Size, NodeConfig], Person2D | None]]] = {
    YOLO: ('detections', _of_yolo),
    ZED: ('objects', _of_zed),
    OPENPOSE: ('pose_key_points_list', _of_openpose),
}
