"""Keypoint messages of a bag or a sequence file, each with the time at which it is due."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mocap_ros.io.bags import Bag
from mocap_ros.io.messages import Header, encode_keypoints
from mocap_ros.io.sequence import Sequence, load_sequence

CAMERA_FRAME = 'camera'


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
