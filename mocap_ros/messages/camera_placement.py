"""Where the camera is in the frame of the outputs, and the people in that frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.people import CameraVertical, Person3D


class CameraPlacement(NamedTuple):
    """The camera in the frame of the outputs.

    Attributes:
        frame_id: name of the camera's optical frame; may be empty.
        pose: transform from the optical frame to the frame of the outputs; None where they are one.
    """

    frame_id: str
    pose: RigidTransform | None = None

    def place(self, people: Sequence[Person3D]) -> Sequence[Person3D]:
        """Return the people with joints, velocities and covariances in the frame of the outputs.

        What belongs to the camera (scale, rotation, translation) stays in the optical frame.
        """
        pose = self.pose
        if pose is None:
            return people
        return [
            replace(
                p,
                joints=pose.apply(p.joints),
                velocity=pose.rotate(p.velocity),
                root_covariance=pose.rotate_covariance(p.root_covariance),
                root_velocity_covariance=pose.rotate_covariance(p.root_velocity_covariance),
            )
            for p in people
        ]

    def place_vertical(self, vertical: CameraVertical | None) -> CameraVertical | None:
        """Return the vertical in the frame of the outputs."""
        if vertical is None or self.pose is None:
            return vertical
        return CameraVertical(self.pose.rotate(vertical.direction), vertical.std)
