# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Warn when no messages of people arrive, and suggest why."""

from __future__ import annotations

import time

from rclpy.node import Node

from mocap_ros.messages.foreign.definitions import HRI_SKELETON
from mocap_ros.messages.input_types import KEYPOINT_TYPES

START_DETECTOR = 'start the detector, or remap the topic to the one on which it publishes'


class SilenceMonitor:
    """Observer of the time since the last message on the topic that brings people or names the tracked bodies.

    Args:
        node: The node that subscribes.
        name: Relative name of the topic.
        msgtype: Type of the messages that the node expects on the topic.
        advice: What to do where no other topic has such messages.
    """

    def __init__(self, node: Node, name: str, msgtype: str, advice: str = START_DETECTOR) -> None:
        self._node = node
        self._name = name
        self._type = msgtype
        self._advice = advice
        self._last_input = time.monotonic()  # s, steady clock; at first the time of the start
        self._has_input = self._has_warned = False

    def note_input(self) -> None:
        """Note that a message of people has arrived."""
        self._last_input = time.monotonic()
        self._has_input, self._has_warned = True, False

    @property
    def silence_s(self) -> float:
        """Time in s since the last message, or since the start."""
        return time.monotonic() - self._last_input

    def check(self, limit: float) -> None:
        """Log a warning if no message has arrived for `limit` seconds; log it once until a message arrives."""
        silence = self.silence_s
        if self._has_warned or silence < limit:
            return
        self._has_warned = True
        topic = self._node.resolve_topic_name(self._name)
        cause = 'check that its publisher is still running' if self._has_input else self._explain(topic)
        self._node.get_logger().warning(f'no message has arrived on {topic} for {silence:.0f} s: {cause}')

    def _explain(self, topic: str) -> str:
        """Return why no message may have arrived since the start, and what to do."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        published_types = {p.topic_type for p in publishers} - {self._type}
        if published_types:
            accepted_types = sorted(published_types & {*KEYPOINT_TYPES, HRI_SKELETON})
            advice = f'; start the node with -p node.input_type:={accepted_types[0]}' if accepted_types else ''
            return f'its publisher sends {", ".join(sorted(published_types))}, expected {self._type}{advice}'
        if publishers:
            return 'its publisher sends nothing, or its QoS is incompatible; check the detector'
        candidates = sorted(self._list_published_topics() - {topic})
        if candidates:
            return f'nobody publishes it; remap {self._name} to {" or ".join(candidates)}?'
        return f'nobody publishes it; {self._advice}'

    def _list_published_topics(self) -> set[str]:
        """List the topics on which somebody publishes messages of the expected type."""
        topics = (t for t, types in self._node.get_topic_names_and_types() if self._type in types)
        return {t for t in topics if self._node.count_publishers(t)}
