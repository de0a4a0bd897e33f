"""Keypoint messages of a bag or a sequence file, each with the time at which it is due."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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


Watch = Callable[[Iterable[Sample], int], Iterable[Sample]]


def samples_of(
    path: Path, topic: str | None = None, watch: Watch = lambda samples, _: samples
) -> Iterator[Sample]:
    """The keypoint messages of a sequence file (.npz) or a bag.

    Args:
        path: of the file, or folder of the bag.
        topic: of the keypoints, where a bag has several.
        watch: wrapped around the samples, of which there are as many as its second argument says.

    Raises:
        InputError: the file is neither, or broken.
    """
    if path.suffix == '.npz':
        sequence = load_sequence(path)
        yield from watch(sequence_samples(sequence), len(sequence))
        return
    with Bag(path) as bag:
        topics = [bag.keypoints_topic(topic)]
        yield from watch((Sample(m.time_ns, m.raw) for m in bag.messages(topics)), bag.count(topics))


def sequence_samples(sequence: Sequence, frame_id: str = CAMERA_FRAME) -> Iterator[Sample]:
    """The frames of a sequence as messages, with its timestamps."""
    for frame, stamp_ns in enumerate(sequence.stamps_ns):
        people = [sequence.person(frame)]
        raw = encode_keypoints(Header(stamp_ns, frame_id), sequence.image_size, people)
        yield Sample(stamp_ns, raw)
