# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The input topics of the tracker: what each one carries, its message type, and where it is in a bag."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from enum import Enum
from typing import NamedTuple

from mocap_ros.bags.reader import Bag
from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError, InputError, suggest
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON, find_current_type
from mocap_ros.messages.imu import IMU
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.transforms import TRANSFORMS

TRACKED_SUFFIX = '/bodies/tracked'  # end of the ROS4HRI topic that lists the ids of the tracked bodies
BODY_SUFFIX = '/skeleton2d'  # end of the ROS4HRI topics that carry the 2D keypoints of one body each


class Source(Enum):
    """What an input topic carries.

    The value is the default name of the topic; the value of `BODY` is the namespace of one topic for each body.
    """

    KEYPOINTS = 'keypoints'  # the 2D keypoints of all people in an image
    CAMERA_INFO = 'camera_info'  # the calibration of the camera
    TRACKED_BODIES = '/humans/bodies/tracked'  # the ids of the tracked bodies (ROS4HRI)
    BODY = '/humans/bodies'  # the 2D keypoints of one body (ROS4HRI)
    TRANSFORMS = '/tf'  # transforms between coordinate frames, each at its time
    STATIC_TRANSFORMS = '/tf_static'  # transforms that hold at all times
    IMU = 'imu'  # the accelerations of the camera or its robot


PEOPLE_SOURCES = (Source.KEYPOINTS, Source.TRACKED_BODIES, Source.BODY)  # the sources that describe people
PEOPLE_TYPES = (HRI_IDS, HRI_SKELETON, *KEYPOINT_TYPES)  # the types of their messages
TRANSFORM_SOURCES = (Source.TRANSFORMS, Source.STATIC_TRANSFORMS)  # the sources that say where the camera is


def list_input_types(keypoints_type: str) -> dict[Source, str]:
    """Return the types of all inputs but transforms, given that of keypoints as in `node.input_type`."""
    camera = {Source.CAMERA_INFO: CAMERA_INFO, Source.IMU: IMU}
    current_type = find_current_type(keypoints_type)
    if current_type == HRI_SKELETON:
        return {Source.TRACKED_BODIES: HRI_IDS, Source.BODY: HRI_SKELETON, **camera}
    if current_type not in KEYPOINT_TYPES:
        supported = *KEYPOINT_TYPES, HRI_SKELETON
        by_name = {name.rpartition('/')[2]: name for name in supported}
        nearest = suggest(keypoints_type.rpartition('/')[2], by_name)
        raise ConfigError(f'node.input_type: no {keypoints_type!r}; {nearest}')
    return {Source.KEYPOINTS: keypoints_type, **camera}


def list_transform_sources(node: NodeConfig, *, has_imu: bool = True) -> tuple[Source, ...]:
    """Return the sources of the transforms that the outputs need, or an IMU that is fixed to the camera."""
    if node.output_frame and not node.camera_pose:
        return TRANSFORM_SOURCES
    return (Source.STATIC_TRANSFORMS,) if has_imu and not node.imu_pose else ()


def find_latched_inputs(bag: Bag) -> set[str]:
    """Return the latched topics of input types, of which each further file of a bag repeats the last messages."""
    return bag.latched_topics & set(bag.topics_of_type({CAMERA_INFO, TRANSFORMS, *PEOPLE_TYPES}))


def find_robot_topics(bag: Bag, node: NodeConfig, recorded: AbstractSet[str]) -> dict[str, Source]:
    """Return the sources of the topics of transforms and of an IMU in a bag that are inputs.

    The IMU is the only one of the `recorded` inputs of a recorded run or, where there are none, of the bag. Names
    of topics of transforms end as in ROS, but for recorded ones, which may have been remapped.
    """
    imus = [topic for topic in bag.topics_of_type([IMU]) if topic in recorded or not recorded]
    found = dict.fromkeys(imus, Source.IMU) if len(imus) == 1 else {}
    wanted = list_transform_sources(node, has_imu=bool(found))
    for topic in bag.topics_of_type([TRANSFORMS]):
        source = next((s for s in TRANSFORM_SOURCES if topic.endswith(s.value)), None)
        if topic in recorded:
            found[topic] = source or TRANSFORM_SOURCES[topic in bag.latched_topics]
        elif source in wanted:
            found[topic] = source
    return found


def make_repeat_keys(source: Source | None, raw: bytes, *, is_accepted: bool = True) -> frozenset[str] | None:
    """Return the `repeat_keys` of `Recorder.write` with which an input is recorded.

    Each publisher of static transforms sends its own frames, which hold beside those of the others: the keys are
    the names of the frames that a message places. Any other input replaces the one before it, unless it was
    refused: None.
    """
    if not is_accepted:
        return None
    if source is not Source.STATIC_TRANSFORMS:
        return frozenset()
    return frozenset(t.child_frame_id for t in decode(raw, TRANSFORMS).transforms)


def make_body_topic(tracked_topic: str, body_id: str) -> str:
    """Return the topic of a body's keypoints, in the namespace of the topic that lists the tracked bodies."""
    return f'{tracked_topic.rpartition("/")[0]}/{body_id}{BODY_SUFFIX}'


def parse_body_id(topic: str) -> str:
    """Return the id of the body whose keypoints are published on a topic."""
    return topic.rpartition('/')[0].rpartition('/')[2]


def find_people_topics(bag: Bag, name: str | None = None) -> dict[str, Source]:
    """Find the topics of 2D keypoints in a bag, of which `name` chooses where it holds several.

    Keypoints come either on one topic for all people or, from ROS4HRI, on one topic for each body beside the topic
    that lists the tracked bodies, which is the one to name.
    """
    groups = {topic: {topic: Source.KEYPOINTS} for topic in bag.topics_of_type(KEYPOINT_TYPES)}
    tracked_topics = [t for t in bag.topics_of_type([HRI_IDS]) if t == name or t.endswith(TRACKED_SUFFIX)]
    groups |= {topic: {topic: Source.TRACKED_BODIES} for topic in tracked_topics}
    for topic in bag.topics_of_type([HRI_SKELETON]):
        own = (t for t in tracked_topics if make_body_topic(t, parse_body_id(topic)) == topic)
        beside = f'{topic.rpartition("/")[0].rpartition("/")[0]}/tracked'
        if topic.endswith(BODY_SUFFIX):
            groups.setdefault(next(own, beside), {})[topic] = Source.BODY
    if name is None and len(groups) > 1:  # a list of bodies without keypoints may be an output
        groups = {t: s for t, s in groups.items() if set(s.values()) != {Source.TRACKED_BODIES}} or groups
    chosen = [sources for topic, sources in groups.items() if name in (None, topic)]
    if len(chosen) == 1:
        return chosen[0]
    if chosen:
        raise InputError(f'{bag.path}: the bag has several keypoint topics, choose one: {", ".join(groups)}')
    wanted = f'topic {name}' if name else 'topic'
    present = ', '.join(f'{topic} ({msgtype})' for topic, msgtype in bag.topics.items()) or 'nothing'
    supported = ' or '.join((*KEYPOINT_TYPES, HRI_SKELETON))
    raise InputError(f'{bag.path}: there is no {wanted} of {supported}; the bag has {present}')


class InputTopics(NamedTuple):
    """The topics of a bag that are the inputs of one camera."""

    people: Mapping[str, Source]  # as of `find_people_topics`
    keypoints_type: str  # the value of `node.input_type` that suits them
    camera_info: str | None  # the topic of their CameraInfo; None where the bag has none


def find_inputs(bag: Bag, name: str | None = None, camera_info: str | None = None) -> InputTopics:
    """Find the inputs in a bag; `name` chooses their topic, and `camera_info` that of their CameraInfo."""
    people = find_people_topics(bag, name)
    first, *_ = people
    keypoints_type = bag.topics[first] if people[first] is Source.KEYPOINTS else HRI_SKELETON
    return InputTopics(people, keypoints_type, bag.find_camera_info_topic([*people], camera_info))
