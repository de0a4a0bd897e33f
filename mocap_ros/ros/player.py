"""Publishes recorded messages at their own pace, as a camera and its detector would."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from mocap_ros.errors import ConfigError, MocapError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import NS
from mocap_ros.ros.message_types import interface_class
from mocap_ros.ros.qos import playing_profile
from mocap_ros.runtime.playback import Due, Playback, PlayedTopic

CLOCK = 'rosgraph_msgs/msg/Clock'
SETTLE_SECONDS = 0.5

Watch = Callable[[Iterable[Due], int], Iterable[Due]]


@dataclass(frozen=True)
class Pace:
    """How to play.

    Attributes:
        rate: times the recorded pace; infinity for as fast as possible.
        wait: s to wait for a subscriber before the first message.
        loop: begin again at the end, until interrupted.
        clock: Hz, to publish recorded time on /clock; 0: not at all.
    """

    rate: float = 1.0
    wait: float = 10.0
    loop: bool = False
    clock: float = 0.0


class Player:
    """Publishes messages, unchanged, with the QoS they were recorded with.

    A best-effort subscriber may learn of this publisher later than the publisher of the subscriber, and misses
    what is sent in between; hence a short pause before the first message. A reliable one misses nothing.

    Args:
        playback: what to publish.
        pace: when.

    Attributes:
        played: messages published so far.
        skipped: topics whose type is not installed.
    """

    def __init__(self, playback: Playback, pace: Pace) -> None:
        self._playback = playback
        self._pace = pace
        self._publishers: dict[int, Any] = {}
        self._clock: _Clock | None = None
        self.played = 0
        self.skipped: list[str] = []

    def play(self, watch: Watch = lambda messages, _: messages) -> None:
        """Publish everything once, or again and again.

        Args:
            watch: wrapped around the messages, of which there are as many as its second argument says.

        Raises:
            MocapError: nobody subscribes in time, or no type is installed.
        """
        context = rclpy.Context()
        rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node('mocap_player', context=context)
        try:
            self._advertise(node)
            self._wait_for_subscriber()
            while True:
                self._once(watch(self._playback, self._playback.count))
                if not self._pace.loop:
                    break
            for publisher in self._publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=1))
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)

    def _advertise(self, node: Any) -> None:
        for number, topic in enumerate(self._playback.topics):
            kind = self._class_of(topic)
            if kind is not None:
                self._publishers[number] = node.create_publisher(kind, topic.name, playing_profile(topic.qos))
        if not self._publishers:
            raise MocapError(f'nothing to play: {self.skipped[0] if self.skipped else "no topics"}')
        if self._pace.clock:
            self._clock = _Clock(node, self._pace.clock)

    def _class_of(self, topic: PlayedTopic) -> Any:
        try:
            return interface_class(topic.type)
        except ConfigError as error:
            self.skipped.append(f'{topic.name}: {error}')
            return None

    def _wait_for_subscriber(self) -> None:
        kinds = {n: t.type for n, t in enumerate(self._playback.topics)}
        awaited = [p for n, p in self._publishers.items() if kinds[n] != CAMERA_INFO] or [
            *self._publishers.values()
        ]
        end = time.monotonic() + self._pace.wait
        while not any(p.get_subscription_count() for p in awaited):
            if time.monotonic() > end:
                names = ', '.join(p.topic_name for p in awaited)
                raise MocapError(f'nobody subscribed to {names} within {self._pace.wait:g} s')
            time.sleep(0.02)
        time.sleep(SETTLE_SECONDS)

    def _once(self, messages: Iterable[Due]) -> None:
        start, first_ns = time.monotonic(), -1
        for message in messages:
            first_ns = message.due_ns if first_ns < 0 else first_ns
            self._sleep_until(start + (message.due_ns - first_ns) / NS / self._pace.rate, message.due_ns)
            publisher = self._publishers.get(message.topic)
            if publisher is not None:
                publisher.publish(message.raw)
                self.played += 1

    def _sleep_until(self, end: float, end_ns: int) -> None:
        """Sleep until a steady time, which is `end_ns` of recorded time; tell the time meanwhile."""
        while (left := end - time.monotonic()) > 0:
            if self._clock is not None:
                self._clock.tell(end_ns - round(left * self._pace.rate * NS))
                left = min(left, self._clock.period)
            time.sleep(left)
        if self._clock is not None:
            self._clock.tell(end_ns)


class _Clock:
    """Publishes /clock, at most so many times a second."""

    def __init__(self, node: Any, rate: float) -> None:
        self.period = 1 / rate
        self._type = interface_class(CLOCK)
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._publisher = node.create_publisher(self._type, '/clock', qos)
        self._due = 0.0

    def tell(self, time_ns: int) -> None:
        """Publish this time, if it is due."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self.period
            message = self._type()
            message.clock.sec, message.clock.nanosec = divmod(time_ns, NS)
            self._publisher.publish(message)
