"""What the inputs of a run are, on which topics they come, and which topics of a bag they are."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from mocap_ros.bags.reader import Bag
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.accepted import KEYPOINT_TYPES
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.foreign.definitions import BODY, BODY_IDS

TRACKED_ENDING = '/bodies/tracked'
BODY_ENDING = '/skeleton2d'


class Source(Enum):
    """What an input is; the value is the name of its topic, and of bodies, what their topics begin with."""

    KEYPOINTS = 'keypoints'
    CAMERA_INFO = 'camera_info'
    TRACKED = '/humans/bodies/tracked'
    BODY = '/humans/bodies'


PEOPLE_SOURCES = (Source.KEYPOINTS, Source.TRACKED, Source.BODY)


def input_types(keypoints: str) -> dict[Source, str]:
    """Every input and its type, where keypoints come as messages of that type.

    Raises:
        ConfigError: they cannot.
    """
    if keypoints == BODY:
        return {Source.TRACKED: BODY_IDS, Source.BODY: BODY, Source.CAMERA_INFO: CAMERA_INFO}
    if keypoints not in KEYPOINT_TYPES:
        known = ', '.join((*KEYPOINT_TYPES, BODY))
        raise ConfigError(f'node.input_type {keypoints!r} is not supported; {known} are')
    return {Source.KEYPOINTS: keypoints, Source.CAMERA_INFO: CAMERA_INFO}


def body_topic(tracked: str, body: str) -> str:
    """Where the keypoints of a body come, beside the topic that says who is tracked."""
    return f'{tracked.rpartition("/")[0]}/{body}{BODY_ENDING}'


def body_of(topic: str) -> str:
    """The body whose keypoints come there."""
    return topic.rpartition('/')[0].rpartition('/')[2]


def people_topics(bag: Bag, name: str | None = None) -> dict[str, Source]:
    """The topics of 2D keypoints and what each is: one of everybody, or ROS4HRI's with one for each body.

    Args:
        bag: to look into.
        name: of the topic, where there are several; of bodies, the one that says who is tracked.

    Raises:
        InputError: there is none, or more than one; lists those there are.
    """
    found = {topic: {topic: Source.KEYPOINTS} for topic in bag.of_type(KEYPOINT_TYPES)}
    tracked = [t for t in bag.of_type([BODY_IDS]) if t == name or t.endswith(TRACKED_ENDING)]
    found |= {topic: {topic: Source.TRACKED} for topic in tracked}
    for topic in bag.of_type([BODY]):
        beside = next((t for t in tracked if body_topic(t, body_of(topic)) == topic), '')
        if topic.endswith(BODY_ENDING):
            found.setdefault(beside or _tracked_beside(topic), {})[topic] = Source.BODY
    chosen = [topics for topic, topics in found.items() if name in (None, topic)]
    if len(chosen) == 1:
        return chosen[0]
    if chosen:
        raise InputError(f'{bag.path}: several keypoint topics, choose one: {", ".join(found)}')
    wanted = f'topic {name}' if name else 'topic'
    there = ', '.join(f'{t} ({kind})' for t, kind in bag.topics.items()) or 'nothing'
    raise InputError(f'{bag.path}: no {wanted} of {" or ".join((*KEYPOINT_TYPES, BODY))}; the bag has {there}')


def people_type(bag: Bag, topics: Mapping[str, Source]) -> str:
    """The type of the messages on topics that `people_topics` found, as `node.input_type` names it."""
    first, *_ = topics
    return bag.topics[first] if topics[first] is Source.KEYPOINTS else BODY


def _tracked_beside(topic: str) -> str:
    """The topic that would say who is tracked, of a body's topic."""
    return f'{topic.rpartition("/")[0].rpartition("/")[0]}/tracked'
