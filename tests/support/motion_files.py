# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A motion and small motion-capture files, and rotation matrices to check them."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from mocap_ros.models.model_file import load_base_poses

FRAMES = 40
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
