# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Small bags of the demo recording, as a corpus for batch runs."""

from __future__ import annotations

from pathlib import Path

from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from tests.support.pipeline_inputs import FAST_VALUES, encode_demo_frames, with_stamp

START_NS = 1_700_000_000_000_000_000  # ns since the epoch
STEP_NS = 33_333_333  # ns, 30 images per second
# Parameters with which a replay is fast, for the command line.
FAST_ARGUMENTS = [word for name, value in FAST_VALUES.items() for word in ('--set', f'{name}={value}')]


def write_demo_bag(folder: Path, frames: int, gap: range = range(0)) -> Path:
    """Write a bag of the demo recording, in a circle; nobody is in the images of the gap."""
    seen = encode_demo_frames(60)
    with Recorder(folder, RecorderConfig(min_free_mb=0)) as recorder:
        for frame in range(frames):
            stamp_ns = START_NS + frame * STEP_NS
            empty = encode_keypoints(Header(stamp_ns, 'camera'), (640, 480), [])
            raw = empty if frame in gap else with_stamp(seen[frame % 60], stamp_ns)
            recorder.write('/keypoints', KEYPOINTS, raw, stamp_ns, stamp_ns)
    return folder


def write_corpus(root: Path, frames: dict[str, int]) -> Path:
    """Write bags of some numbers of frames, by name, into a folder."""
    for name, count in frames.items():
        write_demo_bag(root / name, count)
    return root


def read_outputs(path: Path) -> list[BagMessage]:
    """Return the messages of a bag, without those that each file of a split bag repeats."""
    with Bag(path) as bag:
        repeated = ('/skeleton_definition', '/mocap_replay/journal')
        return list(bag.messages([t for t in bag.topics if t not in repeated]))
