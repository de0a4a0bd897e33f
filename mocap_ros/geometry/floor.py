# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The floor that people stand on, as a camera sees it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rigid_transform import RigidTransform

Array = NDArray[np.float64]

# Last parts of the names of frames whose z axis is up: those of REP 105, and the usual one of a robot cell. The
# frames of a robot itself tilt with it.
LEVEL_FRAMES = frozenset({'map', 'odom', 'world'})


class Floor(NamedTuple):
    """A level floor below a camera.

    Attributes:
        upward: (3,) unit vector upwards in the camera's optical frame.
        camera_height: m, of the camera over the floor, positive; None where only the direction is known.
    """

    upward: Array
    camera_height: float | None

    @staticmethod
    def find(camera_pose: RigidTransform, height: float | None) -> Floor:
        """Return the floor at a height in a frame whose z axis is up.

        Args:
            camera_pose: transform from the camera's optical frame to the frame with z up.
            height: m, z of the floor in that frame; None if it is not known. A floor above the camera is not known
                either.
        """
        camera_height = None if height is None else float(camera_pose.translation[2]) - height
        is_below = camera_height is not None and camera_height > 0
        return Floor(camera_pose.rotation[2], camera_height if is_below else None)


def is_level(frame_id: str) -> bool:
    """Return whether the z axis of a frame is up, by its name."""
    return frame_id.rpartition('/')[2] in LEVEL_FRAMES
