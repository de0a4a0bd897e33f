# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoint messages of the demo recording, bags of them, and a pipeline that is fast enough for tests."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, OutputMessage, decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.playback import encode_sequence
from tests.support.camera_messages import camera_info
from tests.support.message_objects import create_header, encode

STEP_NS = 33_333_333  # between two frames of the demo; 30 Hz
FAST_VALUES = {
    'tracker.model': 'walk',
    'tracker.components': 8,
    'tracker.iterations': 1,
    'node.camera_info_wait': 0.0,
}
FAST_CONFIG = with_values(Config(), FAST_VALUES)


def encode_demo_frames(count: int) -> list[bytes]:
    """Return the first frames of the demo recording, one person at 30 Hz, as Keypoints2DArray in CDR."""
    return [frame.raw for frame in islice(encode_sequence(make_recording().sequence()), count)]


def with_stamp(raw: bytes, stamp_ns: int) -> bytes:
    message = decode(raw, KEYPOINTS)
    message.header = create_header(Header(stamp_ns, 'camera'))
    return encode(message, KEYPOINTS)


def write_keypoints_bag(folder: Path, stream: Sequence[bytes], info: bytes = b'', start_ns: int = 1) -> Path:
    """Write a bag of a CameraInfo, unless it is empty, and of keypoints at 30 Hz; return the folder."""
    with Recorder(folder, RecorderConfig(min_free_mb=0)) as recorder:
        if info:
            recorder.write('/camera_info', CAMERA_INFO, info, start_ns, start_ns)
        for i, raw in enumerate(stream):
            time_ns = start_ns + i * STEP_NS
            recorder.write('/keypoints', KEYPOINTS, raw, time_ns, time_ns)
    return folder


def read_messages(bag_path: Path, topic: str) -> list[bytes]:
    with Bag(bag_path) as bag:
        return [m.raw for m in bag.messages([topic])]


def make_calibrated(config: Config = FAST_CONFIG) -> Pipeline:
    """Return a pipeline that has the CameraInfo."""
    pipeline = Pipeline(config)
    pipeline.set_camera_info(camera_info())
    return pipeline


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
    return decode({o.topic: o for o in outputs}['skeletons'].data, SKELETONS)


class LineLog:
    """Logger of a run; each line begins with its level."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, message: str) -> None:
        self.lines.append(f'info {message}')

    def warning(self, message: str) -> None:
        self.lines.append(f'warning {message}')

    def error(self, message: str) -> None:
        self.lines.append(f'error {message}')
