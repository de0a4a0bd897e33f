# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Where the camera is in the frame of the outputs, and the people in that frame.

What is seen at p moves with the velocity v in the optical frame. With T the transform of the camera now and T'
that of a time h before, it moves in the frame of the outputs with the velocity

    R v + (T p - T' p) / h

where the second term is the motion of the camera. Covariances of velocities do not know how well this is known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array, copy_with
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.geometry.rotations import multiply_quaternions
from mocap_ros.people import CameraVertical, People, PredictedPeople


class CameraPlacement(NamedTuple):
    """The camera in the frame of the outputs."""

    frame_id: str  # name of the camera's optical frame; may be empty
    # Transform from the optical frame to the frame of the outputs; None where they are one
    pose: RigidTransform | None = None
    # The same a little earlier, of a camera that may move; None where it does not or is not known
    before: RigidTransform | None = None
    step_s: float = 0.0  # h, s by which that was earlier

    @property
    def centre(self) -> Array:
        """(3,) m, the camera in the frame of the outputs."""
        return np.zeros(3) if self.pose is None else self.pose.translation

    def invert(self) -> CameraPlacement:
        """Return the placement that takes people from the frame of the outputs to the optical frame."""
        return CameraPlacement('', None if self.pose is None else self.pose.inverse())

    def place(self, people: People) -> People:
        """Return the people with joints, orientations, velocities and covariances in the frame of the outputs.

        What belongs to the camera (scale, rotation, translation) stays in the optical frame.
        """
        pose = self.pose
        if pose is None or not len(people):
            return people
        return copy_with(
            people,
            joints=pose.apply(people.joints),
            joint_velocity=pose.rotate(people.joint_velocity) + self._find_own_motion(people.joints),
            joint_orientation=multiply_quaternions(np.array(pose.quaternion), people.joint_orientation),
            root_covariance=pose.rotate_covariance(people.root_covariance),
            root_velocity_covariance=pose.rotate_covariance(people.root_velocity_covariance),
        )

    def _find_own_motion(self, joints: Array) -> Array | float:
        """Return the velocity (..., 3) m/s in the output frame of places (..., 3) m that move with the camera."""
        if self.pose is None or self.before is None:
            return 0.0
        return np.asarray((self.pose.apply(joints) - self.before.apply(joints)) / self.step_s)

    def place_predicted(self, people: PredictedPeople) -> PredictedPeople:
        """Return people who are predicted in the frame of the outputs.

        The prediction follows the motion that the camera saw, so that of the camera is added.
        """
        pose = self.pose
        if pose is None:
            return people
        return people._replace(
            joints=pose.apply(people.joints) + people.ahead * self._find_own_motion(people.joints),
            root_covariance=pose.rotate_covariance(people.root_covariance),
        )

    def place_vertical(self, vertical: CameraVertical | None) -> CameraVertical | None:
        """Return the vertical in the frame of the outputs."""
        if vertical is None or self.pose is None:
            return vertical
        return vertical._replace(direction=self.pose.rotate(vertical.direction))
