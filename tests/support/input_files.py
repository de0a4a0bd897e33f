# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Input files: a walk as detectors write it; a motion, small motion-capture files and matrices to check them."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.config import NodeConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.detections import Detections, select_person
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.model_file import load_base_poses

FRAMES = 40
FPS = 25.0  # Hz
VIDEO = ReadingOptions(fps=FPS, image_size=(640, 480))
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


Z_UP_TO_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def make_poses() -> np.ndarray:
    """Return poses (F, 15, 3) in m, z up, of a walker who moves through space."""
    model = load_base_poses('walk')
    theta = np.sin(np.arange(FRAMES)[:, None] / 5 + np.arange(4)) * model.std[:4]
    return model.poses(theta) + np.linspace([0, 0, 0.9], [2, 1, 0.9], FRAMES)[:, None]


def rotation_matrix(axis: str, degrees: float) -> np.ndarray:
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


# A skeleton of two bones, and a motion of two frames.
ASF = """# made for a test
:version 1.10
:name x
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name upper
     direction 0 -1 0
     length 3
     axis 20 30 40   XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
     id 2
     name lower
     direction 0.6 -0.8 0
     length 2
     axis 5 0 -7  XYZ
    dof rx
    limits (-10.0 170.0)
  end
:hierarchy
  begin
    root upper
    upper lower
  end
"""
AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 10 20 30
upper 15 25 35
lower 45
2
root 0 0 0 0 0 0
upper 0 0 0
lower 0
"""


def make_bvh(change: Callable[[str], str]) -> str:
    return change(
        'HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\n'
        'OFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.1\n1 2 3\n'
    )
