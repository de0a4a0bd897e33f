"""Publishes recorded keypoints at their own pace, as a camera and its detector would."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from mocap_ros.errors import MocapError
from mocap_ros.io.bags import Bag
from mocap_ros.io.messages import KEYPOINTS, Header, encode_keypoints
from mocap_ros.io.sequence import Sequence, load_sequence
from mocap_ros.ros.types import message_class

CAMERA_FRAME = 'camera'
DEPTH = 10


class Sample(NamedTuple):
    """A Keypoints2DArray as CDR, and when it is due, ns on any clock."""

    due_ns: int
    raw: bytes


def samples_of(path: Path, topic: str | None = None) -> Iterator[Sample]:
    """The keypoint messages of a sequence file (.npz) or a bag.

    Args:
        path: of the file, or folder of the bag.
        topic: of the keypoints, where a bag has several.

    Raises:
        InputError: the file is neither, or broken.
    """
    if path.suffix == '.npz':
        yield from sequence_samples(load_sequence(path))
        return
    with Bag(path) as bag:
        for message in bag.messages([bag.keypoints_topic(topic)]):
            yield Sample(message.time_ns, message.raw)


def sequence_samples(sequence: Sequence, frame_id: str = CAMERA_FRAME) -> Iterator[Sample]:
    """The frames of a sequence as messages, with its timestamps."""
    for frame, stamp_ns in enumerate(sequence.stamps_ns):
        people = [sequence.person(frame)]
        raw = encode_keypoints(Header(stamp_ns, frame_id), sequence.image_size, people)
        yield Sample(stamp_ns, raw)


def play(samples: Iterable[Sample], topic: str = 'keypoints', rate: float = 1.0, wait: float = 10.0) -> int:
    """Publish messages at their own pace, unchanged.

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
        publisher = node.create_publisher(message_class(KEYPOINTS), topic, qos)
        end = time.monotonic() + wait
        while not publisher.get_subscription_count():
            if time.monotonic() > end:
                raise MocapError(f'nobody subscribed to {publisher.topic_name} within {wait:g} s')
            time.sleep(0.02)
        played, start, first_ns = 0, time.monotonic(), 0
        for sample in samples:
            first_ns = first_ns if played else sample.due_ns
            delay = start + (sample.due_ns - first_ns) * 1e-9 / rate - time.monotonic()
            time.sleep(max(delay, 0.0))
            publisher.publish(sample.raw)
            played += 1
        return played
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
