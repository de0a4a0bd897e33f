# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Subscribe to the inputs of the node."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.node import Node

from mocap_ros.bags.topics import (
    PEOPLE_SOURCES,
    Source,
    list_input_types,
    list_transform_sources,
    make_body_topic,
)
from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.foreign_types import HRI_IDS
from mocap_ros.messages.input_types import decode_ids
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.qos import INPUT_QOS, INPUT_QUEUE_DEPTH, STATIC_TF_QOS, TF_QOS
from mocap_ros.ros.topics import SilenceMonitor, subscribe

if TYPE_CHECKING:
    from mocap_ros.ros.live import LiveRun

# A body id that may be part of a topic name: letters, digits and single underscores, without a leading digit.
BODY_ID_IN_TOPIC = re.compile(r'(?!\w*__)[A-Za-z_][A-Za-z0-9_]*')
MAX_TOPIC_CHARACTERS = 247  # of the name of a topic, more than which the middleware refuses

# The QoS profile of the subscription to each input; by default `INPUT_QOS`.
QOS_BY_SOURCE = {Source.TRANSFORMS: TF_QOS, Source.STATIC_TRANSFORMS: STATIC_TF_QOS}

MAX_TAKE_S = 0.02  # s; for which the messages of a topic are taken in a row; delays those of others, and the end
MAX_PUBLISHERS = 16  # of a topic, whose messages are counted; guards the memory against ever new ones


class LostMessages:
    """Counter of the messages of a topic that were sent but did not arrive, by their numbers.

    The middleware reports what is lost on the way, but not what it drops because too much waits for the node.
    """

    def __init__(self) -> None:
        self._last_numbers: dict[bytes, int] = {}  # by publisher

    def count(self, info: Mapping[str, Any]) -> int:
        """Return how many messages of the same publisher are missing before one; 0 if it has no number."""
        number = info.get('publication_sequence_number')
        if number is None:
            return 0
        publisher = bytes((info.get('publisher_gid') or {}).get('data', b''))
        last = self._last_numbers.pop(publisher, number - 1)
        if len(self._last_numbers) >= MAX_PUBLISHERS:
            del self._last_numbers[next(iter(self._last_numbers))]
        self._last_numbers[publisher] = number
        return max(number - last - 1, 0)


class InputSubscriptions:
    """Subscriptions to keypoints, CameraInfo, Imu and transforms, and for ROS4HRI to each tracked body.

    `silence` observes when no people arrive. The types of the inputs are added to `versions`; `types` has that of
    each source, without transforms whose type is not installed.
    """

    def __init__(
        self, node: Node, input_type: str, versions: MessageVersions, get_limits: Callable[[], NodeConfig]
    ) -> None:
        self._node = node
        self._versions = versions
        self._get_limits = get_limits
        self.types = list_input_types(input_type)
        for msgtype in self.types.values():
            versions.add_input(msgtype)
        if sources := list_transform_sources(get_limits()):
            try:
                versions.add_input(TRANSFORMS)
                self.types |= dict.fromkeys(sources, TRANSFORMS)
            except ConfigError as error:
                if Source.TRANSFORMS in sources:
                    node.get_logger().warning(
                        f'node.output_frame: {error}; transforms cannot be received, so people are published in '
                        f'the frame of the camera; install {TRANSFORMS.partition("/")[0]}, or set node.camera_pose'
                    )
        self._subscriptions: dict[str, Any] = {}  # by topic
        self._body_topics: set[str] = set()
        self._run: LiveRun | None = None
        people_source = next(iter(self.types))
        self.silence = SilenceMonitor(node, people_source.value, self.types[people_source])

    @property
    def topics(self) -> list[str]:
        """Absolute names of the subscribed topics, without those of ROS4HRI bodies."""
        return [self._node.resolve_topic_name(s.value) for s in self.types if s is not Source.BODY]

    def subscribe(self, run: LiveRun) -> None:
        """Subscribe to all inputs; the thread of the executor passes their messages to a run."""
        self._run = run
        self.silence.restart()
        for source in self.types:
            if source is not Source.BODY:
                self._subscribe_to(source, source.value)

    def unsubscribe(self) -> None:
        """Destroy all subscriptions."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions = {}
        self._body_topics = set()
        self._run = None

    def _subscribe_to(self, source: Source, name: str) -> None:
        topic = self._node.resolve_topic_name(name)
        message_class = load_interface_class(self.types[source])
        lost_messages = LostMessages()

        def take_all(raw: bytes, info: Any) -> None:
            """Take a message, and all others that wait; the executor alone takes one each time that it wakes."""
            taken = (raw, info)
            handle = self._subscriptions[name].handle
            count = 0
            deadline_s = time.monotonic() + MAX_TAKE_S
            while taken is not None:
                raw, info = taken
                if source in PEOPLE_SOURCES and self._run:
                    self._run.statistics.lost += lost_messages.count(info)
                self._take(source, raw, info['source_timestamp'], topic)
                count += 1
                if count > INPUT_QUEUE_DEPTH or time.monotonic() > deadline_s:
                    break
                with handle:
                    taken = handle.take_message(message_class, True)
            if source is Source.TRACKED_BODIES:  # only the newest, as to subscribe takes longer than to take
                self._follow_bodies(raw)

        # rclpy declares parameters for overrides, which would stay behind for every body that leaves
        qos = QOS_BY_SOURCE.get(source, INPUT_QOS)
        overridable = source is not Source.BODY
        keep = partial(self._subscriptions.__setitem__, name)
        subscribe(self._node, self.types[source], name, take_all, qos, overridable=overridable, keep=keep)

    def _take(self, source: Source, raw: bytes, sent_ns: int, topic: str) -> None:
        """Pass a message on as it was received, unless it has only transforms that nodes like this one publish."""
        if source is Source.TRANSFORMS and is_of_people_only(
            self._versions.read(TRANSFORMS, raw), self._get_limits().frame_prefix
        ):
            return
        if self._run:
            self._run.enqueue(source, raw, sent_ns, topic)
        if source in PEOPLE_SOURCES:
            self.silence.restart(has_input=True)

    def _follow_bodies(self, raw: bytes) -> None:
        try:
            _, ids = decode_ids(self._versions.read(HRI_IDS, raw), self._get_limits())
        except InputError:  # the pipeline reports the message as invalid
            return
        tracked_topic = self._node.resolve_topic_name(Source.TRACKED_BODIES.value)
        topics = (make_body_topic(tracked_topic, i) for i in ids if BODY_ID_IN_TOPIC.fullmatch(i))
        wanted = {topic for topic in topics if len(topic) <= MAX_TOPIC_CHARACTERS}
        for topic in self._body_topics - wanted:
            self._node.destroy_subscription(self._subscriptions.pop(topic))
            if self._run:
                self._run.queue.forget(topic)
        for topic in wanted - self._body_topics:
            self._subscribe_to(Source.BODY, topic)
        self._body_topics = wanted
