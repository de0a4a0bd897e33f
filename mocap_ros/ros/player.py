"""Publishes recorded keypoints at their own pace, as a camera and its detector would."""

from __future__ import annotations

import time
from collections.abc import Iterable

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from mocap_ros.errors import MocapError
from mocap_ros.io.messages import KEYPOINTS
from mocap_ros.io.samples import Sample
from mocap_ros.ros.types import interface_class

DEPTH = 1000
SETTLE_SECONDS = 0.5


def play(samples: Iterable[Sample], topic: str = 'keypoints', rate: float = 1.0, wait: float = 10.0) -> int:
    """Publish messages at their own pace, unchanged.

    A best-effort subscriber may learn of this publisher later than the publisher of the subscriber, and misses
    what is sent in between; hence a short pause before the first message. A reliable one misses nothing.

    Args:
        samples: by time.
        topic: to publish on.
        rate: how many times faster than they were made; infinity for as fast as possible.
        wait: s to wait for a subscriber before the first one.

    Returns:
        How many were published.

    Raises:
        MocapError: nobody subscribes in time.
    """
    context = rclpy.Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('mocap_player', context=context)
    try:
        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        publisher = node.create_publisher(interface_class(KEYPOINTS), topic, qos)
        end = time.monotonic() + wait
        while not publisher.get_subscription_count():
            if time.monotonic() > end:
                raise MocapError(f'nobody subscribed to {publisher.topic_name} within {wait:g} s')
            time.sleep(0.02)
        time.sleep(SETTLE_SECONDS)
        played, start, first_ns = 0, time.monotonic(), 0
        for sample in samples:
            first_ns = first_ns if played else sample.due_ns
            delay = start + (sample.due_ns - first_ns) * 1e-9 / rate - time.monotonic()
            time.sleep(max(delay, 0.0))
            publisher.publish(sample.raw)
            played += 1
        publisher.wait_for_all_acked(Duration(seconds=1))
        return played
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
