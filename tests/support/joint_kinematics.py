# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Where the joints of a body are, given its joint angles, by the formulas of `formats/export/joint_angles.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mocap_ros.formats.export.joint_angles import COORDINATES
from mocap_ros.skeleton import CMU15

Array = np.ndarray
# m; where the joints are in the axes of their segments, of a person who stands upright with hanging arms
STANDING: dict[str, tuple[float, float, float]] = {
    'pelvis': (0, 0, 0), 'lhip': (0.04, -0.1, -0.1), 'rhip': (0.04, -0.1, 0.1),
    'neck': (0, 0.5, 0), 'lshoulder': (0.01, 0.45, -0.18), 'rshoulder': (0.01, 0.45, 0.18), 'head': (0, 0.2, 0),
    'lknee': (0, -0.44, 0), 'rknee': (0, -0.44, 0), 'lankle': (0, -0.42, 0), 'rankle': (0, -0.42, 0),
    'lelbow': (0, -0.3, 0), 'relbow': (0, -0.3, 0), 'lwrist': (0, -0.26, 0), 'rwrist': (0, -0.26, 0),
}  # fmt: skip


def compute_joints(values: Array, places: dict[str, Any]) -> Array:
    """Return the joints (F, 15, 3) in m of coordinates (F, C), written out from the formulas of `joint_angles`."""
    q = dict(zip(COORDINATES, values.T, strict=True))

    def turn(axis: str, name: str, sign: float = 1.0) -> Rotation:
        return Rotation.from_euler(axis, sign * q[name][:, None], degrees=True)

    at = {'pelvis': np.column_stack([q['pelvis_tx'], q['pelvis_ty'], q['pelvis_tz']])}

    def place(joint: str, segment: Rotation, origin: str) -> None:
        at[joint] = at[origin] + segment.apply(np.asarray(places[joint], float))

    pelvis = turn('y', 'pelvis_rotation') * turn('x', 'pelvis_list') * turn('z', 'pelvis_tilt')
    torso = pelvis * turn('z', 'lumbar_extension') * turn('x', 'lumbar_bending') * turn('y', 'lumbar_rotation')
    for joint in ('lhip', 'rhip'):
        place(joint, pelvis, 'pelvis')
    for joint in ('neck', 'lshoulder', 'rshoulder'):
        place(joint, torso, 'pelvis')
    place('head', torso * turn('z', 'neck_extension') * turn('x', 'neck_bending'), 'neck')
    for side, sign in (('r', 1.0), ('l', -1.0)):
        thigh = pelvis * turn('z', f'hip_flexion_{side}') * turn('x', f'hip_adduction_{side}', sign)
        thigh = thigh * turn('y', f'hip_rotation_{side}', sign)
        place(f'{side}knee', thigh, f'{side}hip')
        place(f'{side}ankle', thigh * turn('z', f'knee_angle_{side}', -1.0), f'{side}knee')
        arm = torso * turn('z', f'arm_flex_{side}') * turn('x', f'arm_add_{side}', sign)
        arm = arm * turn('y', f'arm_rot_{side}', sign)
        place(f'{side}elbow', arm, f'{side}shoulder')
        place(f'{side}wrist', arm * turn('z', f'elbow_flex_{side}'), f'{side}elbow')
    return np.stack([at[joint] for joint in CMU15.joints], axis=1)
