"""The floor that people stand on, as a camera sees it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rigid_transform import RigidTransform

Array = NDArray[np.float64]


class Floor(NamedTuple):
    """A level floor below a camera.

    Attributes:
        upward: (3,) unit vector upwards in the camera's optical frame.
        camera_height: m, of the camera over the floor, positive.
    """

    upward: Array
    camera_height: float

    @staticmethod
    def find(camera_pose: RigidTransform, height: float) -> Floor | None:
        """Return the floor at a height in a frame whose z axis is up; None if the camera is not above it.

        Args:
            camera_pose: transform from the camera's optical frame to the frame with z up.
            height: m, z of the floor in that frame.
        """
        camera_height = float(camera_pose.translation[2]) - height
        return Floor(camera_pose.rotation[2], camera_height) if camera_height > 0 else None
