# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Subscribe to topics and publish on them, and warn of what keeps messages from arriving."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions

from mocap_ros.bags.topics import Source
from mocap_ros.errors import ConfigError
from mocap_ros.messages.camera_info import CAMERA_INFO, may_be_one_camera
from mocap_ros.messages.cdr import OutputMessage, read_frame_id
from mocap_ros.messages.foreign_types import HRI_SKELETON
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.qos import BEST_AVAILABLE, NEWEST_QOS, OVERRIDABLE_POLICIES

MAX_ACKNOWLEDGEMENT_S = 0.2  # s; for which a subscriber that does not answer delays the end of the node
START_DETECTOR = 'start the detector, or remap the topic to the one on which it publishes'
STRICTER_SUBSCRIBER = (
    '{topic}: a subscriber requests a stricter {policy} policy than this node offers, so it receives nothing; '
    'relax that policy in the subscriber'
)
WEAKER_PUBLISHER = (
    '{topic}: a publisher offers a weaker {policy} policy than this node requests, so its messages are not '
    'received; change that policy in the publisher, or set the parameters qos_overrides.{topic}.subscription of '
    'this node'
)


def subscribe(
    node: Node,
    msgtype: str,
    name: str,
    take: Callable[..., None],
    qos: QoSProfile,
    *,
    overridable: bool = True,
    keep: Callable[[Any], None] = lambda _: None,
) -> None:
    """Create a subscription whose messages are taken as CDR bytes, and which warns of incompatible publishers.

    With the reliability `BEST_AVAILABLE` it is reliable if no publisher is best effort. When one appears later,
    another subscription takes its place, which is best effort and remains so.

    Args:
        node: node that subscribes.
        msgtype: type of the messages.
        name: name of the topic.
        take: gets a message, and what the middleware says of it if it has a second argument.
        qos: profile.
        overridable: whether the parameters `qos_overrides` may change the profile.
        keep: gets the subscription, and later the one that takes its place.
    """
    subscription: Any = None
    warn = _warn_once(node, name, WEAKER_PUBLISHER)

    def create() -> None:
        nonlocal subscription
        subscription = node.create_subscription(
            load_interface_class(msgtype),
            name,
            take,
            copy(qos),  # rclpy writes the overrides of one topic into it
            raw=True,
            qos_overriding_options=QoSOverridingOptions(OVERRIDABLE_POLICIES) if overridable else None,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=adapt),
        )
        keep(subscription)

    def adapt(event: Any) -> None:
        is_unreliable = event.last_policy_kind == QoSPolicyKind.RELIABILITY
        if is_unreliable and subscription.qos_profile.reliability == BEST_AVAILABLE:
            node.destroy_subscription(subscription)
            create()
        else:
            warn(event)

    create()


def warn_of_subscribers(node: Node, name: str) -> PublisherEventCallbacks:
    """Return the callbacks of a publisher that log subscribers with an incompatible QoS."""
    return PublisherEventCallbacks(incompatible_qos=_warn_once(node, name, STRICTER_SUBSCRIBER))


def _warn_once(node: Node, name: str, line: str) -> Callable[[Any], None]:
    """Return a handler of rclpy's events of incompatible QoS, which logs each policy once."""
    topic = node.resolve_topic_name(name)
    logged = set[str]()

    def warn(event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if policy not in logged:
            logged.add(policy)
            node.get_logger().warning(line.format(topic=topic, policy=policy))

    return warn


class Publishers(dict[str, Any]):
    """Publishers of a node by topic, which publish while it is active, in the installed versions of the types."""

    def __init__(self, node: LifecycleNode, versions: MessageVersions) -> None:
        super().__init__()
        self._node = node
        self._versions = versions

    def add(self, topic: str, msgtype: str, qos: QoSProfile, *, is_active: bool = False) -> None:
        """Create a publisher; `is_active` says that the node is active already."""
        if left_out := self._versions.add_output(msgtype):
            self._node.get_logger().warning(
                f'{topic}: the installed version of {msgtype} has no field {", ".join(left_out)}; '
                'it is published without them'
            )
        events = warn_of_subscribers(self._node, topic)
        message_class = load_interface_class(msgtype)
        self[topic] = self._node.create_lifecycle_publisher(message_class, topic, qos, event_callbacks=events)
        if is_active:
            self[topic].on_activate(None)

    def add_if_installed(self, topic: str, msgtype: str, qos: QoSProfile, consequence: str) -> bool:
        """Create a publisher, or log that the type is not installed and a consequence; return whether it is."""
        try:
            load_interface_class(msgtype)
        except ConfigError as error:
            package = msgtype.partition('/')[0]
            self._node.get_logger().warning(f'{error}; {consequence}; install {package}')
            return False
        self.add(topic, msgtype, qos)
        return True

    def remove(self, topic: str) -> None:
        """Destroy a publisher."""
        self._node.destroy_lifecycle_publisher(self.pop(topic))

    def destroy(self) -> None:
        """Destroy all publishers, when their reliable subscribers have the last messages or do not answer."""
        deadline_s = time.monotonic() + MAX_ACKNOWLEDGEMENT_S
        for topic in [*self]:
            with suppress(RuntimeError):  # not every middleware can say so
                self[topic].wait_for_all_acked(Duration(seconds=max(deadline_s - time.monotonic(), 0.0)))
            self.remove(topic)

    def publish(self, output: OutputMessage) -> None:
        """Publish an output, in the installed version of its type, if its topic has a publisher."""
        if output.topic in self:
            self[output.topic].publish(output.data)


class CameraInfoSearch:
    """Looks for the CameraInfo of a camera on the topics to which the node is not subscribed."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._frame_id = ''
        self._is_found = False
        self._subscriptions: dict[str, Any] = {}  # by topic

    def advance(self, frame_id: str) -> None:
        """Look for the CameraInfo of a `frame_id`, once, and log where it is; an empty one ends the search."""
        if frame_id != self._frame_id:
            self._frame_id = frame_id
            self._is_found = False
        if self._is_found or not frame_id:
            for subscription in filter(None, self._subscriptions.values()):
                self._node.destroy_subscription(subscription)
            self._subscriptions = {}
            return
        own = self._node.resolve_topic_name(Source.CAMERA_INFO.value)
        for topic, types in self._node.get_topic_names_and_types():
            if types == [CAMERA_INFO] and topic not in (own, *self._subscriptions):
                self._subscriptions[topic] = None
                with suppress(RuntimeError):  # SROS2 may forbid it
                    take, keep = partial(self._take, topic), partial(self._subscriptions.__setitem__, topic)
                    subscribe(self._node, CAMERA_INFO, topic, take, NEWEST_QOS, overridable=False, keep=keep)

    def _take(self, topic: str, raw: bytes) -> None:
        frame_id = read_frame_id(raw)
        if frame_id and may_be_one_camera(frame_id, self._frame_id) and not self._is_found:
            self._is_found = True
            self._node.get_logger().warning(
                f'{topic} has the CameraInfo of {frame_id!r}, the camera of the keypoints; remap '
                f'{Source.CAMERA_INFO.value} to it'
            )


class SilenceMonitor:
    """Observer of the time since the last message of a topic; `advice` is for if no other topic has its type."""

    def __init__(self, node: Node, name: str, msgtype: str, advice: str = START_DETECTOR) -> None:
        self._node = node
        self.name = name
        self.type = msgtype
        self._advice = advice
        self.restart()

    def restart(self, *, has_input: bool = False) -> None:
        """Measure from now on: the node is active, or a message has arrived."""
        self._since_s = time.monotonic()
        self._has_input = has_input
        self._has_warned = False

    @property
    def silence_s(self) -> float:
        """Time in s since the last message, or since the start."""
        return time.monotonic() - self._since_s

    def check(self, limit: float) -> None:
        """Log a warning if no message has arrived for `limit` seconds; log it once until a message arrives."""
        silence = self.silence_s
        if self._has_warned or silence < limit:
            return
        self._has_warned = True
        topic = self._node.resolve_topic_name(self.name)
        cause = 'check that its publisher is still running' if self._has_input else self._explain(topic)
        self._node.get_logger().warning(f'no message has arrived on {topic} for {silence:.0f} s: {cause}')

    def _explain(self, topic: str) -> str:
        """Return why no message may have arrived since the start, and what to do."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        published_types = {p.topic_type for p in publishers} - {self.type}
        if published_types:
            accepted_types = sorted(published_types & {*KEYPOINT_TYPES, HRI_SKELETON})
            advice = f'; start the node with -p node.input_type:={accepted_types[0]}' if accepted_types else ''
            return f'its publisher sends {", ".join(sorted(published_types))}, expected {self.type}{advice}'
        if publishers:
            return 'its publisher sends nothing, or its QoS is incompatible; check the detector'
        topics = {t for t, types in self._node.get_topic_names_and_types() if self.type in types} - {topic}
        candidates = sorted(t for t in topics if self._node.count_publishers(t))
        if candidates:
            return f'it has no publisher; remap {self.name} to {" or ".join(candidates)}?'
        return f'it has no publisher; {self._advice}'
