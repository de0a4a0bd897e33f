# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the outputs of the node."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile

from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError
from mocap_ros.messages.cdr import OutputMessage, decode
from mocap_ros.messages.foreign.definitions import HRI_IDS
from mocap_ros.messages.robots.bodies import BODIES, DESCRIPTION, TRACKED
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.ros.diagnostics import DIAGNOSTICS
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.qos import LATCHED_QOS, OUTPUT_QOS, TF_QOS, QosWarnings
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, SWITCHED_OUTPUTS

DIAGNOSTICS_TOPIC = '/diagnostics'
MAX_ACKNOWLEDGEMENT_S = 0.2  # s; for which a subscriber that does not answer delays the end of the node


class OutputPublishers:
    """Publishers of all outputs, which publish only while the lifecycle node is active.

    Args:
        node: The node that publishes.
        qos_warnings: Log of subscribers with an incompatible QoS.
    """

    def __init__(self, node: LifecycleNode, qos_warnings: QosWarnings) -> None:
        self._node = node
        self._qos_warnings = qos_warnings
        self._publishers: dict[str, Any] = {}  # by relative topic name
        self._bodies: dict[str, Any] = {}  # publishers of single bodies by topic; there is no list beforehand
        self._versions: MessageVersions | None = None

    def create(self, versions: MessageVersions, config: NodeConfig) -> None:
        """Create the publishers.

        Args:
            versions: Versions of the message types, to which those of the outputs are added.
            config: Parameters that switch further outputs on.

        Raises:
            ConfigError: A message type is not installed, or the installed version cannot hold the outputs.
        """
        self._versions = versions
        for topics, qos in ((OUTPUTS, OUTPUT_QOS), (LATCHED_OUTPUTS, LATCHED_QOS)):
            for topic, msgtype in topics.items():
                self._create_publisher(topic, msgtype, qos, versions)
        self._create_publisher(DIAGNOSTICS_TOPIC, DIAGNOSTICS, OUTPUT_QOS, versions)
        for field in SWITCHED_OUTPUTS:
            if getattr(config, field):
                self._create_switched_publisher(field, versions)

    def destroy(self) -> None:
        """Destroy all publishers, when their reliable subscribers have the last messages or do not answer."""
        deadline_s = time.monotonic() + MAX_ACKNOWLEDGEMENT_S
        for publisher in (*self._publishers.values(), *self._bodies.values()):
            with suppress(RuntimeError):  # not every middleware can tell
                publisher.wait_for_all_acked(Duration(seconds=max(deadline_s - time.monotonic(), 0.0)))
            self._node.destroy_lifecycle_publisher(publisher)
        self._publishers, self._bodies = {}, {}

    def has_publisher(self, topic: str) -> bool:
        """Return whether an output, by its relative topic name, is published and not only recorded."""
        return topic in self._publishers

    def publish(self, output: OutputMessage) -> None:
        """Publish an output, in the installed version of its type, if its topic has a publisher."""
        publisher = self._publishers.get(output.topic)
        if publisher is None and TRACKED in self._publishers and output.topic.startswith(BODIES):
            publisher = self._bodies.get(output.topic) or self._create_body_publisher(output)
        if publisher is not None:
            publisher.publish(output.data)
        if output.type == HRI_IDS:
            self._destroy_body_publishers(decode(output.data, HRI_IDS).ids)

    def publish_diagnostics(self, raw: bytes) -> None:
        """Publish a DiagnosticArray, given as CDR of the installed version."""
        self._publishers[DIAGNOSTICS_TOPIC].publish(raw)

    def _create_switched_publisher(self, field: str, versions: MessageVersions) -> None:
        """Create the publisher that a parameter switches on; what has no installed type is recorded only."""
        topic, msgtype, _ = SWITCHED_OUTPUTS[field]
        if self._is_installed(field, topic, msgtype):
            self._create_publisher(topic, msgtype, TF_QOS if msgtype == TRANSFORMS else OUTPUT_QOS, versions)

    def _is_installed(self, field: str, topic: str, msgtype: str) -> bool:
        """Return whether the type of an output that a parameter switches on is installed; else log a warning."""
        try:
            load_interface_class(msgtype)
        except ConfigError as error:
            package = msgtype.partition('/')[0]
            what = 'transforms are' if msgtype == TRANSFORMS else f'{topic} is'
            self._node.get_logger().warning(
                f'node.{field}: {error}; {what} recorded but not published; install {package}'
            )
            return False
        return True

    def _create_body_publisher(self, output: OutputMessage) -> Any:
        """Create the publisher of a topic of a single body; it is active at once, for the node is."""
        assert self._versions is not None  # noqa: S101
        qos = LATCHED_QOS if output.type == DESCRIPTION else OUTPUT_QOS
        self._create_publisher(output.topic, output.type, qos, self._versions)
        publisher = self._bodies[output.topic] = self._publishers.pop(output.topic)
        publisher.on_activate(None)
        return publisher

    def _destroy_body_publishers(self, ids: Sequence[str]) -> None:
        """Destroy the publishers of bodies that are not tracked any more."""
        for topic in [t for t in self._bodies if t.split('/')[-2] not in ids]:
            self._node.destroy_lifecycle_publisher(self._bodies.pop(topic))

    def _create_publisher(self, topic: str, msgtype: str, qos: QoSProfile, versions: MessageVersions) -> None:
        if left_out := versions.add_output(msgtype):
            self._node.get_logger().warning(
                f'{topic}: the installed version of {msgtype} has no field {", ".join(left_out)}; '
                'it is published without them'
            )
        self._publishers[topic] = self._node.create_lifecycle_publisher(
            load_interface_class(msgtype),
            topic,
            qos,
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=lambda event: self._qos_warnings.warn_of_subscriber(topic, event.last_policy_kind)
            ),
        )
