# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoint messages of the demo recording, and a pipeline that is fast enough for tests."""

from __future__ import annotations

from itertools import islice
from typing import Any

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.cdr import Header, OutputMessage, create_header, decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.playback import encode_sequence

FAST_VALUES = {'tracker.model': 'walk', 'tracker.components': 8, 'tracker.iterations': 1}
FAST_CONFIG = with_values(Config(), FAST_VALUES)


def encode_demo_frames(count: int) -> list[bytes]:
    """Return the first frames of the demo recording, one person at 30 Hz, as Keypoints2DArray in CDR."""
    return [frame.raw for frame in islice(encode_sequence(make_recording().sequence()), count)]


def with_stamp(raw: bytes, stamp_ns: int) -> bytes:
    """Return a keypoints message with another stamp."""
    message = decode(raw, KEYPOINTS)
    message.header = create_header(Header(stamp_ns, 'camera'))
    return encode(message, KEYPOINTS)


def process(pipeline: Pipeline, raw: bytes) -> tuple[OutputMessage, ...]:
    """Feed keypoints that must be accepted; return the outputs."""
    result = pipeline.feed(Source.KEYPOINTS, raw)
    assert result.verdict is Verdict.ACCEPTED, result.reason
    return result.outputs


def reject(pipeline: Pipeline, raw: bytes, verdict: Verdict) -> str:
    """Feed keypoints that must not be accepted; return the reason."""
    result = pipeline.feed(Source.KEYPOINTS, raw)
    assert (result.verdict, result.outputs, result.error_traceback) == (verdict, (), '')
    return result.reason


def decode_skeletons(outputs: tuple[OutputMessage, ...]) -> Any:
    """Return the Skeleton3DArray among the outputs of one frame."""
    return decode({o.topic: o for o in outputs}['skeletons'].data, SKELETONS)
