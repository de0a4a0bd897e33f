# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encode the frames of a keypoint sequence as messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import encode_keypoints

DEFAULT_FRAME_ID = 'camera'  # header.frame_id of sequences that do not name their camera


class EncodedFrame(NamedTuple):
    """One frame of a sequence as a message.

    Attributes:
        stamp_ns: Stamp of the frame in ns, on the clock of the sequence.
        raw: The frame as mocap_ros_msgs/Keypoints2DArray in CDR.
    """

    stamp_ns: int
    raw: bytes


def encode_sequence(sequence: KeypointSequence) -> Iterator[EncodedFrame]:
    """Encode every frame of a sequence as a message with the frame's stamp and `DEFAULT_FRAME_ID`."""
    for frame, stamp_ns in enumerate(sequence.stamps_ns):
        people = [sequence.person(frame)]
        raw = encode_keypoints(Header(stamp_ns, DEFAULT_FRAME_ID), sequence.image_size, people)
        yield EncodedFrame(stamp_ns, raw)
