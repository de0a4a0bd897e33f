# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Subscribe to the inputs of the node."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node

from mocap_ros.bags.topics import (
    PEOPLE_SOURCES,
    TRANSFORM_SOURCES,
    Source,
    list_input_types,
    make_body_topic,
    reads_transforms,
)
from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.foreign_types import HRI_IDS
from mocap_ros.messages.input_types import decode_ids
from mocap_ros.messages.transform_tree import is_of_people_only
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.qos import (
    INPUT_QOS,
    INPUT_QUEUE_DEPTH,
    STATIC_TF_QOS,
    TF_QOS,
)
from mocap_ros.ros.topics import SilenceMonitor, subscribe

# A body id that may be part of a topic name: letters, digits and single underscores, without a leading digit.
BODY_ID_IN_TOPIC = re.compile(r'(?!\w*__)[A-Za-z_][A-Za-z0-9_]*')
MAX_TOPIC_CHARACTERS = 247  # of the name of a topic, more than which the middleware refuses

# The QoS profile of the subscription to each input; by default `INPUT_QOS`.
QOS_BY_SOURCE = {Source.TRANSFORMS: TF_QOS, Source.STATIC_TRANSFORMS: STATIC_TF_QOS}

MAX_TAKE_S = 0.02  # s; for which the messages of a topic are taken in a row; delays those of others, and the end
MAX_PUBLISHERS = 16  # of a topic, whose messages are counted; guards the memory against ever new ones

# A function that takes a message: its source, its CDR bytes, the time of sending in ns, and its topic.
Receive = Callable[[Source, bytes, int, str], None]


class LostMessages:
    """Counter of the messages of a topic that were sent but did not arrive, by their numbers.

    The middleware reports what is lost on the way, but not what it drops because too much waits for the node.
    """

    def __init__(self) -> None:
        self._last_numbers: dict[bytes, int] = {}  # by publisher

    def count(self, info: Mapping[str, Any]) -> int:
        """Return how many messages of the same publisher are missing before a message.

        Args:
            info: What the middleware says of the message; 0 is returned where it does not number messages.
        """
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
    """Subscriptions to keypoints, CameraInfo and transforms, and for ROS4HRI to each tracked body.

    Args:
        node: The node that subscribes.
        input_type: Message type of the keypoints, as in `node.input_type`.
        versions: Versions of the message types, to which those of the inputs are added.
        get_limits: Function that returns the parameters of the node, which limit the content of a message.

    Attributes:
        types: Message type of each source.

    Raises:
        ConfigError: The type is not supported or not installed.
    """

    def __init__(
        self,
        node: Node,
        input_type: str,
        versions: MessageVersions,
        get_limits: Callable[[], NodeConfig],
    ) -> None:
        self._node = node
        self._versions = versions
        self._get_limits = get_limits
        self.types = list_input_types(input_type, reads_transforms=reads_transforms(get_limits()))
        self._add_types()
        self._subscriptions: list[Any] = []
        self._body_subscriptions: dict[str, Any] = {}  # by topic
        self._receive: Receive = lambda *_: None
        self._note_lost: Callable[[int], None] = lambda _: None
        self._forget_topic: Callable[[str], None] = lambda _: None
        self._silence: SilenceMonitor | None = None

    def _add_types(self) -> None:
        """Add the types of the inputs to the versions; transforms whose type is not installed are left out."""
        for source in [s for s in self.types if s not in TRANSFORM_SOURCES]:
            self._versions.add_input(self.types[source])
        if Source.TRANSFORMS not in self.types:
            return
        try:
            self._versions.add_input(TRANSFORMS)
        except ConfigError as error:
            self.types = {s: t for s, t in self.types.items() if s not in TRANSFORM_SOURCES}
            package = TRANSFORMS.partition('/')[0]
            self._node.get_logger().warning(
                f'node.output_frame: {error}; transforms cannot be received, so people are published in the frame '
                f'of the camera; install {package}, or set node.camera_pose'
            )

    @property
    def topics(self) -> list[str]:
        """Absolute names of the subscribed topics, without those of ROS4HRI bodies."""
        return [self._node.resolve_topic_name(s.value) for s in self.types if s is not Source.BODY]

    def subscribe(
        self, receive: Receive, note_lost: Callable[[int], None], forget_topic: Callable[[str], None]
    ) -> None:
        """Subscribe to all inputs and pass their messages to `receive`, in the thread of the executor.

        Args:
            receive: Function that takes the messages.
            note_lost: Function that takes the number of messages that were sent but did not arrive.
            forget_topic: Function that takes the absolute name of a topic that is no longer subscribed to.
        """
        self._receive, self._note_lost, self._forget_topic = receive, note_lost, forget_topic
        for source in self.types:
            if source is not Source.BODY:
                self._subscriptions.append(self._subscribe_to(source, source.value))
        people_source = next(iter(self.types))
        self._silence = SilenceMonitor(self._node, people_source.value, self.types[people_source])

    def unsubscribe(self) -> None:
        """Destroy all subscriptions."""
        for subscription in (*self._subscriptions, *self._body_subscriptions.values()):
            self._node.destroy_subscription(subscription)
        self._subscriptions, self._body_subscriptions = [], {}

    def check_silence(self, limit: float) -> None:
        """Log a warning if no people have arrived for `limit` seconds."""
        if self._silence is not None:
            self._silence.check(limit)

    def _subscribe_to(self, source: Source, name: str) -> Any:
        topic = self._node.resolve_topic_name(name)
        message_class, lost_messages = load_interface_class(self.types[source]), LostMessages()

        def take_all(raw: bytes, info: Any) -> None:
            """Take a message, and all others that wait; the executor alone takes one each time that it wakes."""
            taken, count, deadline_s = (raw, info), 0, time.monotonic() + MAX_TAKE_S
            while taken is not None:
                raw, info = taken
                if source in PEOPLE_SOURCES:
                    self._note_lost(lost_messages.count(info))
                self._take(source, raw, info['source_timestamp'], topic)
                count += 1
                if count > INPUT_QUEUE_DEPTH or time.monotonic() > deadline_s:
                    break
                with subscription.handle:
                    taken = subscription.handle.take_message(message_class, True)
            if source is Source.TRACKED_BODIES:  # only the newest, as to subscribe takes longer than to take
                self._follow_bodies(raw)

        # rclpy declares parameters for overrides, which would stay behind for every body that leaves
        subscription = subscribe(
            self._node,
            self.types[source],
            name,
            take_all,
            QOS_BY_SOURCE.get(source, INPUT_QOS),
            overridable=source is not Source.BODY,
        )
        return subscription

    def _take(self, source: Source, raw: bytes, sent_ns: int, topic: str) -> None:
        """Pass a message on as it was received, unless it has only transforms that nodes like this one publish."""
        if source in TRANSFORM_SOURCES and is_of_people_only(
            self._versions.read(TRANSFORMS, raw), self._get_limits().frame_prefix
        ):
            return
        self._receive(source, raw, sent_ns, topic)
        if source in PEOPLE_SOURCES and self._silence is not None:
            self._silence.note_input()

    def _follow_bodies(self, raw: bytes) -> None:
        """Subscribe to the tracked bodies and unsubscribe from those that are no longer tracked."""
        try:
            _, ids = decode_ids(self._versions.read(HRI_IDS, raw), self._get_limits())
        except InputError:  # the pipeline reports the message as invalid
            return
        tracked_topic = self._node.resolve_topic_name(Source.TRACKED_BODIES.value)
        topics = (make_body_topic(tracked_topic, i) for i in ids if BODY_ID_IN_TOPIC.fullmatch(i))
        wanted = {topic for topic in topics if len(topic) <= MAX_TOPIC_CHARACTERS}
        for topic in self._body_subscriptions.keys() - wanted:
            self._node.destroy_subscription(self._body_subscriptions.pop(topic))
            self._forget_topic(topic)
        for topic in wanted - self._body_subscriptions.keys():
            self._body_subscriptions[topic] = self._subscribe_to(Source.BODY, topic)
