"""The frames of a sequence as keypoint messages, each with the time at which it is due."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mocap_ros.formats.sequence_file import Sequence
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import encode_keypoints

CAMERA_FRAME = 'camera'


class Sample(NamedTuple):
    """A Keypoints2DArray as CDR, and when it is due, ns on any clock."""

    due_ns: int
    raw: bytes


def sequence_samples(sequence: Sequence, frame_id: str = CAMERA_FRAME) -> Iterator[Sample]:
    """The frames of a sequence as messages, with its timestamps."""
    for frame, stamp_ns in enumerate(sequence.stamps_ns):
        people = [sequence.person(frame)]
        raw = encode_keypoints(Header(stamp_ns, frame_id), sequence.image_size, people)
        yield Sample(stamp_ns, raw)
