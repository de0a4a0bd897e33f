# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of every type that is accepted as keypoints, with the same two people in each."""

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from mocap_ros.bags.topics import Source, make_body_topic
from mocap_ros.config import Config, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, decode, typestore
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON, OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.input_types import COCO17, HRI18, ZED38
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from tests.support.camera_messages import create_header, create_message, encode
from tests.support.pipeline_inputs import FAST_CONFIG, STEP_NS

IMAGE_SIZE = 640, 480  # px
HRI_IDS_TOPIC = '/humans/bodies/tracked'
BASE_CONFIG = with_values(FAST_CONFIG, {'node.image_width': IMAGE_SIZE[0], 'node.image_height': IMAGE_SIZE[1]})
LIMITS = BASE_CONFIG.node
Input = tuple[Source, bytes, str]  # where a message comes from, the message, and its topic
INPUT_TYPES = (YOLO_DETECTIONS, HRI_SKELETON, ZED_OBJECTS, OPENPOSE_POSES, KEYPOINTS)


def make_config(msgtype: str, **values: object) -> Config:
    return with_values(BASE_CONFIG, {'node.input_type': msgtype, **values})


def make_people(frame: int) -> list[Person2D]:
    """Return two people side by side; some joints of each are missing."""
    keypoints = make_recording().keypoints[frame].astype(float)
    people = []
    for number, shift in enumerate((0.0, 120.0)):
        score = np.where(np.arange(len(keypoints)) == 3 + number, 0.0, keypoints[:, 2])
        points = np.where(score[:, None] > 0, keypoints[:, :2] + [shift, 0], np.nan)
        people.append(Person2D(f'b{number}', COCO17, points, score))
    return people


def make_header(frame: int) -> Header:
    return Header((frame + 1) * STEP_NS, 'camera')


def encode_frame(msgtype: str, frame: int, **fields: object) -> bytes:
    return encode(create_message(msgtype, header=create_header(make_header(frame)), **fields), msgtype)


def encode_yolo(frame: int) -> bytes:
    """Encode a frame as yolo_ros does: ids start at 1 and unseen joints are absent. The order is reversed."""
    detections = []
    for person in make_people(frame):
        detection = create_blank_message('yolo_msgs/msg/Detection')
        detection.id, detection.class_name = person.id, 'person'
        for j in np.flatnonzero(person.score)[::-1].tolist():
            x, y = person.points[j].tolist()
            place, score = create_message('yolo_msgs/msg/Point2D', x=x, y=y), float(person.score[j])
            keypoint = create_message('yolo_msgs/msg/KeyPoint2D', id=j + 1, point=place, score=score)
            detection.keypoints.data.append(keypoint)
        detections.append(detection)
    detections.append(create_blank_message('yolo_msgs/msg/Detection'))  # an object without keypoints
    return encode_frame(YOLO_DETECTIONS, frame, detections=detections)


def encode_zed(frame: int) -> bytes:
    objects = []
    for number, person in enumerate(make_people(frame)):
        one = create_blank_message('zed_msgs/msg/Object')
        one.skeleton_available, one.body_format, one.confidence = True, 2, 80.0
        one.tracking_available, one.label_id = True, number
        for place in one.skeleton_2d.keypoints:
            place.kp = np.full(2, np.nan, 'f4')
        one.skeleton_keypoint_confidence = np.full(70, np.nan, np.float32)
        for joint, place in ZED38.items():
            one.skeleton_keypoint_confidence[place] = 100 * person.score[COCO17.index(joint)]
            one.skeleton_2d.keypoints[place].kp = person.points[COCO17.index(joint)].astype('f4')
        objects.append(one)
    return encode_frame(ZED_OBJECTS, frame, objects=objects)


def encode_openpose(frame: int) -> bytes:
    poses = [
        create_message(
            'openpose_ros2_msgs/msg/PoseKeyPoints',
            pose_key_points=[
                create_message('openpose_ros2_msgs/msg/PoseKeyPoint', x=float(x), y=float(y), score=float(s))
                for (x, y), s in zip(np.nan_to_num(p.points), p.score, strict=True)
            ],
        )
        for p in make_people(frame)
    ]
    return encode_frame(OPENPOSE_POSES, frame, pose_key_points_list=poses)


def encode_body(person: Person2D, stamp: Header) -> bytes:
    """Encode a body as ROS4HRI does: normalised coordinates, and the neck between the shoulders."""
    keypoint = {j: (p, s) for j, p, s in zip(person.joints, person.points, person.score, strict=True)}
    shoulders = [keypoint['lshoulder'], keypoint['rshoulder']]
    keypoint['neck'] = (np.mean([s[0] for s in shoulders], axis=0), min(s[1] for s in shoulders))
    skeleton = []
    for joint in HRI18:
        point, score = keypoint[joint]
        x, y = np.nan_to_num(point) / IMAGE_SIZE
        skeleton.append(create_message('hri_msgs/msg/NormalizedPointOfInterest2D', x=x, y=y, c=float(score)))
    return encode(create_message(HRI_SKELETON, header=create_header(stamp), skeleton=skeleton), HRI_SKELETON)


def encode_ids(frame: int, *names: str) -> bytes:
    return encode_frame(HRI_IDS, frame, ids=list(names))


def make_hri_inputs(frame: int) -> list[Input]:
    """Return the messages of a frame: the ids of the tracked bodies, then the bodies in reverse order."""
    people = make_people(frame)
    inputs: list[Input] = [(Source.TRACKED_BODIES, encode_ids(frame, *(p.id for p in people)), HRI_IDS_TOPIC)]
    return inputs + [
        (Source.BODY, encode_body(p, make_header(frame)), make_body_topic(HRI_IDS_TOPIC, p.id))
        for p in people[::-1]
    ]


def encode_own(frame: int) -> bytes:
    return encode_keypoints(make_header(frame), IMAGE_SIZE, make_people(frame))


def create_blank_message(msgtype: str) -> Any:
    """Create a message in which every field is zero or empty."""
    _, fields = typestore().fielddefs[msgtype]
    return typestore().types[msgtype](**{name: create_zero(field) for name, field in fields})


def create_zero(field: Any) -> Any:
    """Create the zero or empty value of a field, which is described as rosbags does."""
    node_type, description = Nodetype(field[0]), field[1]
    if node_type is Nodetype.BASE:
        name = description[0]
        return {'string': '', 'bool': False}.get(name, 0.0 if 'float' in name else 0)
    if node_type is Nodetype.NAME:
        return create_blank_message(description)
    element, count = description
    is_numeric = Nodetype(element[0]) is Nodetype.BASE and element[1][0] != 'string'
    if node_type is Nodetype.SEQUENCE:
        return np.zeros(0, element[1][0]) if is_numeric else []
    return np.zeros(count, element[1][0]) if is_numeric else [create_zero(element) for _ in range(count)]


def make_inputs(msgtype: str, frame: int) -> list[Input]:
    """Return the messages of a frame in the order in which they arrive."""
    if msgtype == HRI_SKELETON:
        return make_hri_inputs(frame)
    encoders = {YOLO_DETECTIONS: encode_yolo, ZED_OBJECTS: encode_zed, OPENPOSE_POSES: encode_openpose}
    encoders[KEYPOINTS] = encode_own
    return [(Source.KEYPOINTS, encoders[msgtype](frame), '/keypoints')]


def edit_message(msgtype: str, edit: Callable[[Any], None]) -> bytes:
    message = decode(make_inputs(msgtype, 0)[0][1], msgtype)
    edit(message)
    return encode(message, msgtype)


def feed_all(pipeline: Pipeline, inputs: list[Input]) -> list[ProcessingResult]:
    return [pipeline.feed(*i) for i in inputs]


def decode_skeletons(results: list[ProcessingResult]) -> list[Any]:
    outputs = [o for result in results for o in result.outputs if o.topic == 'skeletons']
    return [decode(o.data, o.type) for o in outputs]
