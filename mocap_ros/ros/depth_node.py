# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node `depth_node`: give 2D keypoints the depths that a registered depth image has at them."""

from __future__ import annotations

import time
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.ros.help import DEPTH_NAME, DEPTH_PARAMETERS, DEPTH_TOPIC, KEYPOINTS_DEPTH_TOPIC, KEYPOINTS_TOPIC
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.nodes import declare_parameters
from mocap_ros.ros.qos import INPUT_QOS, OUTPUT_QOS
from mocap_ros.ros.throttled_log import ThrottledLog
from mocap_ros.ros.topics import subscribe, warn_of_subscribers
from mocap_ros.runtime.depth_pairing import DepthPairing

CHECK_S = 0.02  # s; between looks at keypoints that wait for a depth image


class DepthNode(Node):
    """Node that publishes every message of keypoints again, with depths where a depth image has them."""

    def __init__(self) -> None:
        super().__init__(DEPTH_NAME)
        values: dict[str, Any] = declare_parameters(self, DEPTH_PARAMETERS, 'the option --help')
        self._input_type, self._depth_type = values['input_type'], values['depth_type']
        self._pairing = DepthPairing(self._input_type, self._depth_type)
        self._log, self._count = ThrottledLog(self.get_logger()), 0
        self._versions = MessageVersions()
        for kind in (self._input_type, self._depth_type):
            self._versions.add_input(kind)
        if self._versions.add_output(KEYPOINTS):
            self.get_logger().warning(
                f'the installed {KEYPOINTS} has no depth, as of an older build: build it again'
            )
        events = warn_of_subscribers(self, KEYPOINTS_DEPTH_TOPIC)
        published = load_interface_class(KEYPOINTS)
        self._publisher = self.create_publisher(
            published, KEYPOINTS_DEPTH_TOPIC, OUTPUT_QOS, event_callbacks=events
        )
        subscribe(self, self._input_type, KEYPOINTS_TOPIC, self._take_keypoints, INPUT_QOS)
        subscribe(self, self._depth_type, DEPTH_TOPIC, self._take_depth, INPUT_QOS)
        self.create_timer(CHECK_S, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
        topics = (self.resolve_topic_name(name) for name in (KEYPOINTS_TOPIC, DEPTH_TOPIC, KEYPOINTS_DEPTH_TOPIC))
        self.get_logger().info('keypoints on {} get the depths on {} and are published on {}'.format(*topics))

    def start(self) -> None:
        """Do nothing; the node works since it was created."""

    def close(self) -> None:
        """Do nothing; the node holds nothing but messages."""

    def _take_keypoints(self, raw: bytes) -> None:
        self._pairing.add_keypoints(self._versions.read(self._input_type, raw), time.monotonic())
        self._publish()

    def _take_depth(self, raw: bytes) -> None:
        self._pairing.add_depth(self._versions.read(self._depth_type, raw))
        self._publish()

    def _publish(self) -> None:
        for raw, reason in self._pairing.take(time.monotonic()):
            self._count += 1
            if reason:
                topic = self.resolve_topic_name(KEYPOINTS_TOPIC)
                self._log.report(topic, self._count, reason, is_error=not raw)
            if raw:
                self._publisher.publish(self._versions.write(KEYPOINTS, raw))
