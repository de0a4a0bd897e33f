# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifecycle node `mocap_bridge`: publish what robots take in from the topics `skeletons` and `predictions`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from mocap_ros.bridges.bridge import CONSUMERS, Bridge, check_consumers
from mocap_ros.bridges.ros4hri import BODIES, DESCRIPTION, TRACKED
from mocap_ros.bridges.vmc import Avatar
from mocap_ros.errors import ConfigError, MocapError
from mocap_ros.formats.export.vmc import VmcPose
from mocap_ros.messages.cdr import OutputMessage
from mocap_ros.messages.skeletons import PREDICTIONS, SKELETONS
from mocap_ros.recordings.send_vmc import VmcSender
from mocap_ros.ros.help import BRIDGE_NAME, BRIDGE_PARAMETERS
from mocap_ros.ros.qos import LATCHED_QOS, OUTPUT_QOS
from mocap_ros.ros.skeleton_node import WARN_AFTER_S, SkeletonNode
from mocap_ros.ros.topics import SilenceMonitor

CHECK_PERIOD_S = 0.5  # s; between two looks at how long nothing has arrived
CLEAR_AFTER_S = 2.0  # s without skeletons, after which all people count as gone
START_MOCAP_NODE = 'start mocap_node, or remap the topic to the one on which it publishes'
START_PREDICTIONS = 'start mocap_node with -p node.publish_predictions:=true'


class BridgeNode(SkeletonNode):
    """Lifecycle node that runs a `Bridge` while it is active."""

    def __init__(self) -> None:
        super().__init__(BRIDGE_NAME, BRIDGE_PARAMETERS)
        self._bridge = Bridge([])
        self._inputs: list[tuple[SilenceMonitor, Callable[[bytes], list[OutputMessage]]]] = []
        self._has_warned_of_bodies = False

    def configure(self) -> None:
        """Create the publishers of the consumers whose types are installed."""
        super().configure()
        publish, vmc = str(self._values['publish']).replace(',', ' ').split(), str(self._values['vmc']).strip()
        names = check_consumers(publish) if publish or not vmc else []
        usable = [
            name
            for name in names
            for topic, msgtype, *_ in [CONSUMERS[name]]
            if self._outputs.add_if_installed(topic, msgtype, OUTPUT_QOS, f'{name} cannot be published')
        ]
        if names and not usable:
            raise ConfigError('publish: no message of these consumers can be published')
        self._bridge = Bridge(usable, Avatar(partial(self._send_pose, VmcSender(vmc))) if vmc else None)
        silence = SilenceMonitor(self, 'skeletons', SKELETONS, START_MOCAP_NODE)
        self._inputs = [(silence, self._bridge.feed_skeletons)]
        if any(CONSUMERS[name].reads_predictions for name in usable):
            silence = SilenceMonitor(self, 'predictions', PREDICTIONS, START_PREDICTIONS)
            self._inputs.append((silence, self._bridge.feed_predictions))
        for silence, _ in self._inputs:
            self._versions.add_input(silence.type)

    def start_run(self) -> None:
        """Subscribe."""
        for silence, feed in self._inputs:
            self.subscribe_to(silence, partial(self._take, feed))
        self._timer = self.create_steady_timer(CHECK_PERIOD_S, self._check_silence)
        listened = ' and '.join(self.resolve_topic_name(silence.name) for silence, _ in self._inputs)
        published = [self.resolve_topic_name(topic) for topic in self._outputs]
        if address := self._values['vmc']:
            published.append(f'VMC to {address}')
        self.get_logger().info(
            f'the node is active: it listens on {listened}, and publishes {", ".join(published)}'
        )

    def stop_run(self) -> None:
        """Unsubscribe, and publish that all people are gone."""
        has_run = self._timer is not None
        super().stop_run()
        if has_run:
            self._publish(self._bridge.clear())

    def _take(self, feed: Callable[[bytes], list[OutputMessage]], raw: bytes) -> None:
        self._publish(feed(raw))

    def _send_pose(self, sender: VmcSender, pose: VmcPose, time_s: float) -> None:
        try:
            sender.send(pose, time_s)
        except MocapError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=10.0)

    def _publish(self, outputs: Sequence[OutputMessage]) -> None:
        """Publish outputs; the topics of single bodies of ROS4HRI come and go with them."""
        for output in outputs:
            if output.topic not in self._outputs:
                qos = LATCHED_QOS if output.type == DESCRIPTION else OUTPUT_QOS
                self._outputs.add(output.topic, output.type, qos, is_active=True)
            self._outputs.publish(self._versions.write_output(output))
        if any(output.topic == TRACKED for output in outputs):
            present = {output.topic.split('/')[-2] for output in outputs}
            for topic in [t for t in self._outputs if t.startswith(BODIES) and t != TRACKED]:
                if topic.split('/')[-2] not in present:
                    self._outputs.remove(topic)

    def _check_silence(self) -> None:
        for silence, _ in self._inputs:
            silence.check(WARN_AFTER_S)
        if self._inputs[0][0].silence_s > CLEAR_AFTER_S:
            self._publish(self._bridge.clear())
        if TRACKED in self._outputs and self.count_publishers(TRACKED) > 1 and not self._has_warned_of_bodies:
            self._has_warned_of_bodies = True
            self.get_logger().warning(
                f'{TRACKED}: another node publishes bodies as well; if they are the input of mocap_node '
                '(node.input_type), do not publish them'
            )
