# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The message types that hold the keypoints of all people of an image, and the decoder of each.

Besides mocap_ros_msgs/Keypoints2DArray they are yolo_msgs/DetectionArray, published by yolo_ros,
zed_msgs/ObjectsStamped, published by the ZED wrapper, and openpose_ros2_msgs/PoseKeyPointsList of openpose_ros2.
ROS4HRI (REP-155) publishes the ids of all tracked bodies on one topic, and each body on a topic of its own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mocap_ros.arrays import copy_as_float64
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.keypoints.image_size import ImageSize
from mocap_ros.keypoints.person import Person2D, is_person_class
from mocap_ros.messages.cdr import Header, decode_input, validate_header, validate_text
from mocap_ros.messages.foreign_types import (
    HRI_IDS,
    HRI_SKELETON,
    OPENPOSE_POSES,
    YOLO_DETECTIONS,
    ZED_OBJECTS,
    find_current_type,
)
from mocap_ros.messages.keypoints import (
    KEYPOINTS,
    KeypointsFrame,
    decode_keypoints,
    read_depth,
    read_people,
    validate_person,
)
from mocap_ros.skeleton import keypoint_layout

KEYPOINT_TYPES = (KEYPOINTS, YOLO_DETECTIONS, ZED_OBJECTS, OPENPOSE_POSES)

HRI18 = keypoint_layout('hri18').joints  # joints in the order of hri_msgs/Skeleton2D
COCO17 = keypoint_layout('coco17').joints  # keypoint n of yolo_ros (n = 1 to 17) is joint n - 1 of this layout
# The joints of each layout that OpenPose publishes, by the number of keypoints, which identifies the layout.
OPENPOSE_JOINTS = {
    len(joints): joints for joints in (keypoint_layout(name).joints for name in ('coco17', 'coco18', 'body25'))
}
MAX_CONFIDENCE = 100  # percent; confidences of the ZED are divided by it to give scores in [0, 1]
# Index of each joint in `skeleton_2d.keypoints`, for each body format of the ZED SDK.
ZED18 = {joint: i for i, joint in enumerate(keypoint_layout('coco18').joints)}  # BODY_18_PARTS
ZED34 = {  # BODY_34_PARTS
    'lshoulder': 5, 'lelbow': 6, 'lwrist': 7, 'rshoulder': 12, 'relbow': 13, 'rwrist': 14,
    'lhip': 18, 'lknee': 19, 'lankle': 20, 'rhip': 22, 'rknee': 23, 'rankle': 24,
    'nose': 27, 'leye': 28, 'lear': 29, 'reye': 30, 'rear': 31,
}  # fmt: skip
ZED38 = {  # BODY_38_PARTS; the first 38 keypoints of BODY_70_PARTS are the same
    'nose': 5, 'leye': 6, 'reye': 7, 'lear': 8, 'rear': 9, 'lshoulder': 12, 'rshoulder': 13,
    'lelbow': 14, 'relbow': 15, 'lwrist': 16, 'rwrist': 17, 'lhip': 18, 'rhip': 19,
    'lknee': 20, 'rknee': 21, 'lankle': 22, 'rankle': 23,
}  # fmt: skip
# Coordinate along the optical axis in the frames in which a ZED gives points, by what is in their names.
DEPTH_AXES = {'optical': 2, 'camera_frame': 0}
BODY_FORMATS = (ZED18, ZED34, ZED38, ZED38)  # by the field `body_format`: 18, 34, 38 and 70 keypoints


def decode_frame(raw: bytes, msgtype: str, limits: NodeConfig, size: ImageSize) -> KeypointsFrame:
    """Decode and validate a message of any type that holds all people of an image.

    The size (width, height) in px is (0, 0) where unknown; a Keypoints2DArray gives its own.
    """
    if msgtype == KEYPOINTS:
        return decode_keypoints(raw, limits)
    msgtype = find_current_type(msgtype)
    field, read_person = _READERS[msgtype]
    message = decode_input(raw, msgtype)
    header = validate_header(message.header, limits)
    entries = getattr(message, field)
    people = read_people(
        field, entries, lambda entry: read_person(entry, header.frame_id, size[0], limits), limits
    )
    possible = sum(is_person_class(getattr(entry, 'class_name', None)) for entry in entries)
    return KeypointsFrame(header, *size, people, possible - len(people))


def _read_yolo(detection: Any, frame_id: str, image_width: int, limits: NodeConfig) -> Person2D | None:
    """Read a yolo_msgs/Detection, which holds only the keypoints above the detector's threshold.

    Its points in 3D give depths where they are in the frame of the image.
    """
    keypoints = detection.keypoints.data
    if not keypoints or not is_person_class(detection.class_name):
        return None
    points, score = np.full((len(COCO17), 2), np.nan), np.zeros(len(COCO17))
    for i, keypoint in enumerate(keypoints):
        joint = keypoint.id - 1
        if not 0 <= joint < len(COCO17):
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id}, expected 1 to {len(COCO17)}')
        if np.isfinite(points[joint]).any():
            raise InputError(f'keypoints.data[{i}].id: {keypoint.id} twice')
        points[joint] = keypoint.point.x, keypoint.point.y
        score[joint] = keypoint.score
    depth = np.full(len(COCO17), np.nan)
    for keypoint in detection.keypoints3d.data if detection.keypoints3d.frame_id == frame_id else ():
        if 1 <= keypoint.id <= len(COCO17):
            depth[keypoint.id - 1] = keypoint.point.z
    person_id = validate_text(detection.id, 'id', limits)
    found = validate_person(person_id, COCO17, points, score, image_width, 'keypoints')
    return replace(found, depth=read_depth(depth))


def _read_zed(zed_object: Any, frame_id: str, image_width: int, _: NodeConfig) -> Person2D | None:
    """Read a zed_msgs/Object.

    A keypoint that is NaN, negative or zero was not seen. If no keypoint has a score, every keypoint gets the
    confidence of the whole body. Points in 3D give depths where they are in the camera's frame, x forwards, or in
    its optical frame.
    """
    if not zed_object.skeleton_available:
        return None
    if not 0 <= zed_object.body_format < len(BODY_FORMATS):
        raise InputError(f'body_format: {zed_object.body_format}, expected 0 to {len(BODY_FORMATS) - 1}')
    indices = BODY_FORMATS[zed_object.body_format]
    points = copy_as_float64([zed_object.skeleton_2d.keypoints[i].kp for i in indices.values()])
    seen = np.isfinite(points).all(axis=1) & (points >= 0).all(axis=1) & (points != 0).any(axis=1)
    if not 0 <= zed_object.confidence <= MAX_CONFIDENCE:
        raise InputError(f'confidence: {zed_object.confidence:g}, expected 0 to {MAX_CONFIDENCE}')
    confidence = copy_as_float64(zed_object.skeleton_keypoint_confidence)
    score = confidence[list(indices.values())] / MAX_CONFIDENCE
    if not (score > 0).any():
        score = np.full(len(indices), zed_object.confidence / MAX_CONFIDENCE)
    points = np.where(np.isinf(points), np.nan, points)
    is_tracked = zed_object.tracking_available and zed_object.label_id >= 0
    person_id = str(zed_object.label_id) if is_tracked else ''
    score = np.where(seen, score, 0.0)
    found = validate_person(person_id, tuple(indices), points, score, image_width, 'skeleton_2d.keypoints')
    axis = next((axis for words, axis in DEPTH_AXES.items() if words in frame_id), None)
    if axis is None:
        return found
    depth = [zed_object.skeleton_3d.keypoints[i].kp[axis] for i in indices.values()]
    return replace(found, depth=read_depth(depth))


def _read_openpose(pose: Any, _frame_id: str, image_width: int, _: NodeConfig) -> Person2D | None:
    keypoints = pose.pose_key_points
    if len(keypoints) not in OPENPOSE_JOINTS:
        expected = ', '.join(map(str, OPENPOSE_JOINTS))
        raise InputError(f'pose_key_points: {len(keypoints)} joints, expected {expected}')
    numbers = np.array([(p.x, p.y, p.score) for p in keypoints], np.float64)
    joints = OPENPOSE_JOINTS[len(keypoints)]
    return validate_person('', joints, numbers[:, :2], numbers[:, 2], image_width, 'pose_key_points')


# The field that lists the people of a foreign message, and the reader of one of them.
_READERS = {
    YOLO_DETECTIONS: ('detections', _read_yolo),
    ZED_OBJECTS: ('objects', _read_zed),
    OPENPOSE_POSES: ('pose_key_points_list', _read_openpose),
}


def decode_body(raw: bytes, body_id: str, size: ImageSize, limits: NodeConfig) -> tuple[Header, Person2D]:
    """Decode a Skeleton2D: the header of the image, and the person.

    The normalised coordinates are multiplied by the size of the image. The id is that in the name of the topic.
    """
    message = decode_input(raw, HRI_SKELETON)
    header = validate_header(message.header, limits)
    if not all(size):
        raise InputError(
            'skeleton: coordinates are normalised, and the size of the image is unknown: neither CameraInfo nor '
            'the parameters node.image_width and node.image_height give it'
        )
    numbers = np.array([(p.x, p.y, p.c) for p in message.skeleton], np.float64)
    numbers[(numbers[:, :2] == -1).all(axis=1), :2] = np.nan  # marks an unseen one, and is no share of the image
    person_id = validate_text(body_id, 'id', limits)
    return header, validate_person(person_id, HRI18, numbers[:, :2] * size, numbers[:, 2], 0, 'skeleton')


def decode_ids(raw: bytes, limits: NodeConfig) -> tuple[Header, tuple[str, ...]]:
    """Decode an IdsList: the header of the image, and the ids of all bodies that are tracked in it."""
    message = decode_input(raw, HRI_IDS)
    if len(message.ids) > limits.max_people:
        raise InputError(f'ids: {len(message.ids)}, more than {limits.max_people}')
    ids = tuple(validate_text(i, 'ids', limits) for i in message.ids)
    return validate_header(message.header, limits), ids
