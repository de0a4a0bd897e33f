# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the outputs of a lifecycle node."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile

from mocap_ros.errors import ConfigError
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.qos import QosWarnings

MAX_ACKNOWLEDGEMENT_S = 0.2  # s; for which a subscriber that does not answer delays the end of the node


class Publishers:
    """Publishers of a node, which publish only while it is active.

    Args:
        node: The node that publishes.
        versions: Versions of the message types, to which those of the publishers are added.
        qos_warnings: Log of subscribers with an incompatible QoS.
    """

    def __init__(self, node: LifecycleNode, versions: MessageVersions, qos_warnings: QosWarnings) -> None:
        self._node = node
        self._versions = versions
        self._qos_warnings = qos_warnings
        self._publishers: dict[str, Any] = {}  # by name of the topic, relative or absolute

    def __iter__(self) -> Iterator[str]:
        return iter([*self._publishers])

    def add(self, topic: str, msgtype: str, qos: QoSProfile, *, is_active: bool = False) -> None:
        """Create a publisher; `is_active` says that the node is active already.

        Raises:
            ConfigError: The type is not installed, or its installed version cannot hold the outputs.
        """
        if left_out := self._versions.add_output(msgtype):
            self._node.get_logger().warning(
                f'{topic}: the installed version of {msgtype} has no field {", ".join(left_out)}; '
                'it is published without them'
            )
        publisher = self._node.create_lifecycle_publisher(
            load_interface_class(msgtype),
            topic,
            qos,
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=lambda event: self._qos_warnings.warn_of_subscriber(topic, event.last_policy_kind)
            ),
        )
        if is_active:
            publisher.on_activate(None)
        self._publishers[topic] = publisher

    def add_if_installed(self, topic: str, msgtype: str, qos: QoSProfile, consequence: str) -> bool:
        """Create a publisher, or log that the type is not installed and a consequence; return whether it is.

        Raises:
            ConfigError: The installed version of the type cannot hold the outputs.
        """
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
        self._node.destroy_lifecycle_publisher(self._publishers.pop(topic))

    def destroy(self) -> None:
        """Destroy all publishers, when their reliable subscribers have the last messages or do not answer."""
        deadline_s = time.monotonic() + MAX_ACKNOWLEDGEMENT_S
        for topic in self:
            with suppress(RuntimeError):  # not every middleware can say so
                self._publishers[topic].wait_for_all_acked(
                    Duration(seconds=max(deadline_s - time.monotonic(), 0.0))
                )
            self.remove(topic)

    def publish(self, output: OutputMessage) -> None:
        """Publish an output, in the installed version of its type, if its topic has a publisher."""
        publisher = self._publishers.get(output.topic)
        if publisher is not None:
            publisher.publish(output.data)
