# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Publish recorded messages at their recorded rate, as a camera and its detector would."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_topic_name import validate_topic_name

from mocap_ros.errors import ConfigError, MocapError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import typestore
from mocap_ros.recordings.playback import Playback, PlaybackMessage
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.qos import choose_playback_profile
from mocap_ros.units import NS_PER_S

CLOCK = 'rosgraph_msgs/msg/Clock'  # message type of /clock
SETTLE_SECONDS = 1.0  # s; by less than this a best-effort subscriber discovers the publisher after the reverse
DISCOVERY_POLL_SECONDS = 0.02  # s; pause between two checks for a subscriber
MAX_ACKNOWLEDGEMENT_SECONDS = 1  # s; guards against a subscriber that never acknowledges the last messages

# A function that shows progress while the messages it is given are iterated; its second argument is their number.
ProgressWrapper = Callable[[Iterable[PlaybackMessage], int], Iterable[PlaybackMessage]]


def find_name_fault(topic: str) -> str:
    """Return in one line why no topic can have this name; empty where one can."""
    try:
        validate_topic_name(topic)
        validate_full_topic_name(expand_topic_name(topic, 'node', '/'))
    except NameValidationException as error:  # `Invalid KIND: REASON:`, and lines that point into the name
        return str(error).splitlines()[0].partition(': ')[2].rstrip(':')
    except (ValueError, TypeError):  # an unknown {substitution}; a text that is no UTF-8
        return 'no name of a topic'
    return ''


class Player:
    """Publisher of recorded messages with the QoS with which they were recorded.

    Messages of this package's types are converted to the installed versions where these differ. The player pauses
    for `SETTLE_SECONDS` before the first message: a best-effort subscriber misses those that are sent before it
    has discovered the publisher. `skipped_topics` has a line for each topic whose name is not valid, or whose
    message type is not installed or cannot hold the messages.

    `rate` is a factor of the recorded one, infinity for as fast as possible. The player waits up to `wait_s` for a
    subscriber, and with `loop` starts again at the end, until interrupted. With `clock_hz` > 0, the recorded time
    is published on /clock at that rate.
    """

    def __init__(
        self, playback: Playback, rate: float, wait_s: float = 10.0, clock_hz: float = 0.0, *, loop: bool = False
    ) -> None:
        self._playback = playback
        self._loop = loop
        self._rate = rate
        self._wait_s = wait_s
        self._clock_hz = clock_hz
        self._publishers: dict[int, Any] = {}  # by index of the topic in the playback
        self._versions = MessageVersions()
        self._clock: Any = None  # publisher of /clock
        self._next_clock_s = 0.0  # steady clock; when /clock is due
        self.published_count = 0
        self.skipped_topics: list[str] = []

    @property
    def published_topics(self) -> list[str]:
        """Names of the topics on which messages are published, once `play` has begun."""
        return [self._playback.topics[index].name for index in self._publishers]

    def play(
        self,
        progress: ProgressWrapper = lambda messages, _: messages,
        announce: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Publish all messages once, or repeatedly until interrupted; `announce` gets a line when it waits."""
        context = rclpy.Context()
        rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node('mocap_player', context=context)
        try:
            self._create_publishers(node)
            self._wait_for_subscriber(announce)
            while True:
                self._publish_once(progress(self._playback, self._playback.count))
                if not self._loop:
                    break
            for publisher in self._publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=MAX_ACKNOWLEDGEMENT_SECONDS))
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)

    def _create_publishers(self, node: Any) -> None:
        for index, topic in enumerate(self._playback.topics):
            try:
                if fault := find_name_fault(topic.name):
                    raise ConfigError(fault)
                if topic.type in typestore().types:
                    self._versions.add_output(topic.type)
                message_class = load_interface_class(topic.type)
            except ConfigError as error:
                self.skipped_topics.append(f'{topic.name}: {error}')
                continue
            profile = choose_playback_profile(topic.qos, topic.type)
            self._publishers[index] = node.create_publisher(message_class, topic.name, profile)
        if not self._publishers:
            raise MocapError(f'nothing to play: {self.skipped_topics[0] if self.skipped_topics else "no topics"}')
        if self._clock_hz:
            qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._clock = node.create_publisher(load_interface_class(CLOCK), '/clock', qos)

    def _wait_for_subscriber(self, announce: Callable[[str], None]) -> None:
        """Wait for a subscriber to any topic but CameraInfo, unless CameraInfo is all there is."""
        awaited = [p for i, p in self._publishers.items() if self._playback.topics[i].type != CAMERA_INFO]
        awaited = awaited or [*self._publishers.values()]
        names = ', '.join(p.topic_name for p in awaited)
        announce(f'waiting for a subscriber to {names}, for at most {self._wait_s:g} s')
        deadline = time.monotonic() + self._wait_s
        while not any(p.get_subscription_count() for p in awaited):
            if time.monotonic() > deadline:
                raise MocapError(f'no subscriber to {names} appeared within {self._wait_s:g} s')
            time.sleep(DISCOVERY_POLL_SECONDS)
        time.sleep(SETTLE_SECONDS)

    def _publish_once(self, messages: Iterable[PlaybackMessage]) -> None:
        start = time.monotonic()
        first_ns = -1
        for message in messages:
            first_ns = message.due_ns if first_ns < 0 else first_ns
            elapsed_s = (message.due_ns - first_ns) / NS_PER_S / self._rate
            self._sleep_until(start + elapsed_s, message.due_ns)
            publisher = self._publishers.get(message.topic)
            if publisher is not None:
                msgtype = self._playback.topics[message.topic].type
                publisher.publish(self._versions.write(msgtype, message.raw))
                self.published_count += 1

    def _sleep_until(self, end: float, end_ns: int) -> None:
        """Sleep until `end` (s, steady clock), which is `end_ns` in the recording; publish /clock meanwhile."""
        while (remaining := end - time.monotonic()) > 0:
            if self._clock is not None:
                self._publish_clock(end_ns - round(remaining * self._rate * NS_PER_S))
                remaining = min(remaining, 1 / self._clock_hz)
            time.sleep(remaining)
        if self._clock is not None:
            self._publish_clock(end_ns)

    def _publish_clock(self, time_ns: int) -> None:
        now = time.monotonic()
        if now >= self._next_clock_s:
            self._next_clock_s = now + 1 / self._clock_hz
            message = load_interface_class(CLOCK)()
            message.clock.sec, message.clock.nanosec = divmod(time_ns, NS_PER_S)
            self._clock.publish(message)
