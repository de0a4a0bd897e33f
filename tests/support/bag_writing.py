# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags of synthetic keypoints for the tests of recorder, reader and recovery."""

from pathlib import Path

import numpy as np

from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, encode_skeleton_definition
from mocap_ros.skeleton import CMU15, keypoint_layout

START_NS = 1_700_000_000_000_000_000  # log time of the first frame, ns since the epoch
STEP_NS = 33_000_000  # ns between two frames; about 30 Hz
FRAMES = 60  # in a bag of `write_bag`; long enough for several chunks
DEFINITION = encode_skeleton_definition(CMU15)  # CDR of the latched message

# Topic, log time in ns, publish time in ns, and data of a message.
Message = tuple[str, int, int, bytes]


def make_keypoints(frame: int) -> bytes:
    """Return a keypoints message of one person as CDR; its content depends on the number of the frame only."""
    joints = keypoint_layout('coco17').joints
    points = np.random.default_rng(frame).uniform(0, 640, (len(joints), 2))
    person = Person2D('anna', joints, points, np.ones(len(joints)))
    return encode_keypoints(Header(frame * STEP_NS, 'camera'), (640, 480), [person])


def record_keypoints(recorder: Recorder, frames: int, first: int = 0) -> None:
    for i in range(first, first + frames):
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(i), START_NS + i * STEP_NS, START_NS)


def write_bag(folder: Path, config: RecorderConfig) -> list[Message]:
    """Write a bag with one latched message and `FRAMES` keypoints messages; return all messages."""
    written: list[Message] = [('/skeleton_definition', START_NS, START_NS, DEFINITION)]
    for i in range(FRAMES):
        log_time_ns = START_NS + i * STEP_NS
        written.append(('/keypoints', log_time_ns, log_time_ns - 7, make_keypoints(i)))
    types = {'/keypoints': KEYPOINTS, '/skeleton_definition': SKELETON_DEFINITION}
    with Recorder(folder, config) as recorder:
        recorder.declare_topic('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        for topic, log_time_ns, publish_time_ns, data in written:
            recorder.write(topic, types[topic], data, log_time_ns, publish_time_ns)
    return written
