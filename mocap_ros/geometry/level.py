# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is level: the floor that a camera sees, and the world of people whom a tilted camera sees.

The smallest rotation that takes the vertical u, in a camera's optical frame, to e = (0, -1, 0), that of a level
camera, and so keeps the heading of the camera:

    R = exp([a v / |v|]x),    v = u x e,    a = atan2(|v|, u . e)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.geometry.rotations import MIN_SINE, rotation_from_vector
from mocap_ros.skeleton import CMU15, HIPS

LEVEL_UP = np.array([0.0, -1.0, 0.0])  # upwards in the optical frame of a level camera
MAX_CERTAIN_STD = math.radians(10.0)  # rad; no person is turned by a vertical that is less certain
CALIBRATED_TILT_STD = 0.005  # rad, 0.3 degrees; of a camera that was calibrated to its robot
CALIBRATED_HEIGHT_STD_M = 0.02  # m; of a height that was measured, and of the floor itself
HEADING_FRAMES = 15  # frames; their mean is where a person looks first
LOWEST_PERCENTILE = 5  # %; of the lowest joints, so that a few outliers do not lower the floor
PELVIS = CMU15.index('pelvis')
HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # about the optical axis
# Last parts of the names of frames whose z axis is up: those of REP 105, and the usual one of a robot cell. The
# frames of a robot itself tilt with it.
LEVEL_FRAMES = frozenset({'map', 'odom', 'world'})


def average_vertical(vertical: Array, std: Array) -> Array:
    """Return the mean direction (3,) of unit vectors (..., 3) whose standard deviations (...,) in rad are certain.

    It is NaN if there is none.
    """
    vectors = vertical.reshape(-1, 3)
    total = vectors[np.isfinite(vectors).all(axis=1) & (std.reshape(-1) <= MAX_CERTAIN_STD)].sum(axis=0)
    length = float(np.linalg.norm(total))
    return total / length if length > 0 else np.full(3, np.nan)


def rotation_to_level(vertical: Array) -> Array:
    """Return the rotation (3, 3) from a camera's optical frame to that of a level one; none where NaN."""
    if not np.isfinite(vertical).all():
        return np.eye(3)
    axis, cosine = np.cross(vertical, LEVEL_UP), float(vertical @ LEVEL_UP)
    sine = float(np.linalg.norm(axis))
    if sine < MIN_SINE:
        return np.eye(3) if cosine > 0 else HALF_TURN
    return rotation_from_vector(axis * (math.atan2(sine, cosine) / sine))


class Floor(NamedTuple):
    """A level floor below a camera."""

    upward: Array  # (3,) unit vector upwards in the camera's optical frame
    # m, of the camera over the floor, positive; None where only the direction is known
    camera_height: float | None
    tilt_std: float = CALIBRATED_TILT_STD  # rad, standard deviation of the direction
    height_std: float = CALIBRATED_HEIGHT_STD_M  # m, that of the height
    source: str = ''  # what of a parameter or a topic shows it, in words

    @staticmethod
    def find(camera_pose: RigidTransform, height: float | None, source: str = '') -> Floor:
        """Return the floor at a height in m in the frame with z up in which the pose of the camera is given."""
        camera_height = None if height is None else float(camera_pose.translation[2]) - height
        is_below = camera_height is not None and camera_height > 0
        return Floor(camera_pose.rotation[2], camera_height if is_below else None, source=source)


def build_world(joints: Array, upward: Array, camera_height: float | None) -> Array:
    """Return the transform (4, 4) in m from a camera's optical frame to the world of a person.

    In it z is up, the floor is at z = 0, x is where the person looks first, and the origin is below the first
    pelvis. Where `upward` (3,) is NaN the camera is level, and where its height in m over the floor is not known,
    the floor is that of the lowest joints (F, J, 3), NaN where there are none, of `CMU15` or `BODY26`.
    """
    known = joints[np.isfinite(joints).all(axis=(1, 2))]
    if not len(known):
        return np.full((4, 4), np.nan)
    up = upward if np.isfinite(upward).all() else LEVEL_UP
    left = (known[:HEADING_FRAMES, HIPS[0]] - known[:HEADING_FRAMES, HIPS[1]]).sum(axis=0)
    left -= (left @ up) * up
    left = left if np.linalg.norm(left) > MIN_SINE else np.cross(up, np.roll(up, 1))
    left /= np.linalg.norm(left)
    world = np.eye(4)
    world[:3, :3] = np.cross(left, up), left, up
    world[:3, 3] = -world[:3, :3] @ known[0, PELVIS]
    lowest = float(np.percentile((known @ up).min(axis=1), LOWEST_PERCENTILE))
    world[2, 3] = -lowest if camera_height is None else camera_height
    return world


def is_level(frame_id: str) -> bool:
    """Return whether the z axis of a frame is up, by its name."""
    return frame_id.rpartition('/')[2] in LEVEL_FRAMES
