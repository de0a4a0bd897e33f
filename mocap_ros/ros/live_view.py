# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Draw the people whom a running node publishes, in a viewer.

The view only listens, best effort and with a short queue, so that it never slows the node: a view that is too slow
leaves frames out and stays up to date.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from statistics import median
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.input_types import KEYPOINT_TYPES, decode_frame
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.runtime.scene_rows import SceneRows
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.rerun_recording import LiveDrawing

SKELETONS_TOPIC = 'skeletons'  # the node's output
KEYPOINTS_TOPIC = 'keypoints'  # the node's input
KEPT_IMAGES = 600  # images whose keypoints wait for their skeletons: 5 s, the largest tracker.lag, at 120 Hz
MEASURED_FRAMES = 10_000  # frames whose delays are known; bounds the memory of a view that is open for days
DISCOVERY_S = 0.5  # s; pause between two looks for a publisher of keypoints, whose type is not known before
SPIN_S = 0.1  # s; longest time after which an interrupt or a closed window ends the view

# Two frames that have not been drawn are kept, so that a short pause loses none and the delay stays below 0.1 s.
SKELETONS_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
# Keypoints are drawn with the skeletons of the same stamp, so that some have to wait.
KEYPOINTS_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class LiveView:
    """Draws the skeletons and keypoints on the topics of a node.

    Args:
        drawing: where to draw.
        namespace: namespace of the node.
        keypoints_topic: name of the topic of the keypoints.
        context: context of rclpy that the view uses.

    Attributes:
        frame_count: number of frames drawn so far.
        delays_s: for each of the last frames drawn, s from its publication by the node until it was handed to the
            viewer.
    """

    def __init__(
        self,
        drawing: LiveDrawing,
        namespace: str = '',
        keypoints_topic: str = KEYPOINTS_TOPIC,
        context: Any = None,
    ) -> None:
        self.frame_count = 0
        self.delays_s: deque[float] = deque(maxlen=MEASURED_FRAMES)
        self._drawing = drawing
        self._keypoints_topic = keypoints_topic
        self._limits = NodeConfig()
        self._versions = MessageVersions()
        self._versions.add_input(SKELETONS)
        self._images: dict[int, KeypointsFrame] = {}  # by stamp in ns, oldest first
        self._first_ns: int | None = None  # stamp of the first frame, at which the time line begins
        self._has_keypoints = False
        self._context = context
        self._node = rclpy.create_node('mocap_view', namespace=namespace or None, context=context)
        self._node.create_subscription(
            load_interface_class(SKELETONS),
            SKELETONS_TOPIC,
            lambda raw, info: self._take_skeletons(raw, info['source_timestamp']),
            SKELETONS_QOS,
            raw=True,
        )
        self._node.create_timer(DISCOVERY_S, self._find_keypoints)

    def run(self, is_open: Callable[[], bool]) -> None:
        """Draw until the window is closed or the context is shut down."""
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        try:
            with suppress(ExternalShutdownException):
                while is_open():
                    executor.spin_once(timeout_sec=SPIN_S)
        finally:
            executor.shutdown()
            self._node.destroy_node()

    def _find_keypoints(self) -> None:
        """Subscribe to the keypoints as soon as somebody publishes them, in any type that the node takes."""
        if self._has_keypoints:
            return
        topic = self._node.resolve_topic_name(self._keypoints_topic)
        types = {info.topic_type for info in self._node.get_publishers_info_by_topic(topic)}
        for kind in types & set(KEYPOINT_TYPES):
            self._has_keypoints = True
            try:
                self._versions.add_input(kind)
                message_class = load_interface_class(kind)
            except ConfigError as error:
                self._node.get_logger().warning(f'{topic}: {error}; skeletons are shown without the keypoints')
                continue
            self._node.create_subscription(
                message_class,
                topic,
                lambda raw, kind=kind: self._take_keypoints(kind, raw),
                KEYPOINTS_QOS,
                raw=True,
            )

    def _take_keypoints(self, kind: str, raw: bytes) -> None:
        """Keep the keypoints of an image until its skeletons come; the node reports those that are not valid."""
        try:
            frame = decode_frame(self._versions.read(kind, raw), kind, self._limits, (0, 0))
        except InputError:
            return
        self._images[frame.header.stamp_ns] = frame
        while len(self._images) > KEPT_IMAGES:
            del self._images[next(iter(self._images))]

    def _take_skeletons(self, raw: bytes, sent_ns: int) -> None:
        """Draw the people of an image; leave out a message that cannot be read."""
        rows = SceneRows()
        rows.add_skeletons(self._versions.read(SKELETONS, raw))
        stamp_ns = rows.newest_ns
        frame = self._images.get(stamp_ns)
        if frame is not None:
            rows.add_keypoints_frame(frame)
        try:
            scene_frame = rows.build_frame()
        except InputError:
            return
        if rows.faults:
            return
        if self._first_ns is None:
            self._first_ns = stamp_ns
        self._drawing.draw(scene_frame, (stamp_ns - self._first_ns) / NS_PER_S)
        self.frame_count += 1
        self.delays_s.append((time.time_ns() - sent_ns) / NS_PER_S)


def watch(
    drawing: LiveDrawing, is_open: Callable[[], bool], namespace: str = '', keypoints_topic: str = KEYPOINTS_TOPIC
) -> str:
    """Draw what a node publishes until the window is closed; return a line that says how much was drawn.

    Args:
        drawing: where to draw.
        is_open: tells whether the window is still open.
        namespace: namespace of the node.
        keypoints_topic: name of the topic of the keypoints.
    """
    context = rclpy.Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        view = LiveView(drawing, namespace, keypoints_topic, context)
        with suppress(KeyboardInterrupt):  # the usual end
            view.run(is_open)
    finally:
        rclpy.shutdown(context=context)
    delay = f', median delay {1000 * median(view.delays_s):.0f} ms' if view.delays_s else ''
    return f'{view.frame_count} frames drawn{delay}'
