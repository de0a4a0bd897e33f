# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoint messages of the demo and of synthetic people, bags of them, and a pipeline that is fast enough."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.bags.journal import Acceptance
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, OutputMessage, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, SKELETONS, encode_skeleton_definition
from mocap_ros.recordings.playback import encode_sequence
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.skeleton import CMU15, keypoint_layout
from tests.support.camera_messages import camera_info, create_header, encode

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
    assert result.acceptance is Acceptance.ACCEPTED, result.reason
    return result.outputs


def reject(pipeline: Pipeline, raw: bytes, acceptance: Acceptance) -> str:
    """Feed keypoints that must not be accepted; return the reason."""
    result = pipeline.feed(Source.KEYPOINTS, raw)
    assert (result.acceptance, result.outputs, result.error_traceback) == (acceptance, (), '')
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


START_NS = 1_700_000_000_000_000_000  # log time of the first frame, ns since the epoch
BAG_STEP_NS = 33_000_000  # ns between two frames; about 30 Hz
BAG_FRAMES = 60  # in a bag of `write_bag`; long enough for several chunks
DEFINITION = encode_skeleton_definition(CMU15)  # CDR of the latched message

# Topic, log time in ns, publish time in ns, and data of a message.
Message = tuple[str, int, int, bytes]


def make_keypoints(frame: int) -> bytes:
    """Return a keypoints message of one person as CDR; its content depends on the number of the frame only."""
    joints = keypoint_layout('coco17').joints
    points = np.random.default_rng(frame).uniform(0, 640, (len(joints), 2))
    person = Person2D('anna', joints, points, np.ones(len(joints)))
    return encode_keypoints(Header(frame * BAG_STEP_NS, 'camera'), (640, 480), [person])


def record_keypoints(recorder: Recorder, frames: int, first: int = 0) -> None:
    for i in range(first, first + frames):
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(i), START_NS + i * BAG_STEP_NS, START_NS)


def write_bag(folder: Path, config: RecorderConfig) -> list[Message]:
    """Write a bag with one latched message and `BAG_FRAMES` keypoints messages; return all messages."""
    written: list[Message] = [('/skeleton_definition', START_NS, START_NS, DEFINITION)]
    for i in range(BAG_FRAMES):
        log_time_ns = START_NS + i * BAG_STEP_NS
        written.append(('/keypoints', log_time_ns, log_time_ns - 7, make_keypoints(i)))
    types = {'/keypoints': KEYPOINTS, '/skeleton_definition': SKELETON_DEFINITION}
    with Recorder(folder, config) as recorder:
        recorder.declare_topic('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        for topic, log_time_ns, publish_time_ns, data in written:
            recorder.write(topic, types[topic], data, log_time_ns, publish_time_ns)
    return written
