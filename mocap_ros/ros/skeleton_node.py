# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the lifecycle nodes share that make something of the messages of `mocap_node`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from mocap_ros.config import Parameter
from mocap_ros.errors import InputError
from mocap_ros.ros.message_types import MessageVersions
from mocap_ros.ros.nodes import ManagedNode, declare_parameters
from mocap_ros.ros.qos import OUTPUT_QOS
from mocap_ros.ros.throttled_log import ThrottledLog
from mocap_ros.ros.topics import Publishers, SilenceMonitor, subscribe

WARN_AFTER_S = 15.0  # s without messages, after which the log says so; mocap_node takes its time to start


class SkeletonNode(ManagedNode):
    """Lifecycle node that takes messages of `mocap_node` while it is active."""

    def __init__(self, name: str, declared: Sequence[Parameter]) -> None:
        super().__init__(name)
        self._values = declare_parameters(self, declared, 'the option --help')
        self.has_autostart = bool(self._values['autostart'])
        self._versions = MessageVersions()
        self._outputs = Publishers(self, self._versions)
        self._subscriptions_in_use: list[Any] = []  # while active
        self._timer: Any = None  # while active
        self._log = ThrottledLog(self.get_logger())
        self._counts = Counter[str]()  # of messages by topic

    def configure(self) -> None:
        """Begin with no publishers."""
        self._versions = MessageVersions()
        self._outputs = Publishers(self, self._versions)

    def clean_up(self) -> None:
        """Destroy the publishers."""
        self._outputs.destroy()

    def subscribe_to(self, silence: SilenceMonitor, take: Callable[[bytes], None]) -> None:
        """Subscribe to the topic of a monitor; an InputError that `take` raises is logged."""
        topic = self.resolve_topic_name(silence.name)
        silence.restart()

        def receive(raw: bytes) -> None:
            silence.restart(has_input=True)
            self._counts[topic] += 1
            try:
                take(self._versions.read(silence.type, raw))
            except InputError as error:
                self._log.report(topic, self._counts[topic], str(error))

        keep = self._subscriptions_in_use.append
        subscribe(self, silence.type, silence.name, receive, OUTPUT_QOS, keep=keep)

    def stop_run(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions_in_use:
            self.destroy_subscription(subscription)
        self._subscriptions_in_use = []
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
