# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A walk as detectors write it to files."""

from functools import cache

import numpy as np
import pytest

from mocap_ros.config import NodeConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.detections import Detections, Video, select_person
from mocap_ros.formats.sequence_file import KeypointSequence

FRAMES = 40
FPS = 25.0  # Hz
VIDEO = Video(fps=FPS, image_size=(640, 480))
LIMITS = NodeConfig()
QUICK_OPTIONS = ('--model', 'walk', '--set', 'solver.max_iterations=2')  # of commands whose result does not matter


@cache
def make_walker() -> KeypointSequence:
    """Return the beginning of the demo, where somebody walks, without camera and truth."""
    demo = make_recording().sequence()
    return KeypointSequence(demo.keypoints[:FRAMES], demo.joint_names, demo.timestamps[:FRAMES], demo.image_size)


def flatten_keypoints(sequence: KeypointSequence) -> list[list[float]]:
    """Return x, y and score of all joints of each frame, zeros where not seen, as detectors write them."""
    return np.nan_to_num(sequence.keypoints).reshape(len(sequence), -1).tolist()


def check_same_keypoints(detections: Detections, expected: KeypointSequence) -> None:
    """Check that the only person of a file with a constant frame rate has these keypoints."""
    sequence, _ = select_person(detections)
    assert sequence.joint_names == expected.joint_names
    assert sequence.keypoints == pytest.approx(expected.keypoints, nan_ok=True, abs=1e-4)
    assert sequence.timestamps == pytest.approx(np.arange(FRAMES) / FPS)
    assert sequence.image_size == (640, 480)
