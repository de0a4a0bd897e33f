# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Cameras are about level (beyond TPAMI 2016).

    nu mean_t |tilt_t|^2,    tilt_t = x and z components of C_t e_z

with C_t e_z the body's vertical in the camera frame. The term is for models whose base poses were aligned by
heading, so that the z axis of the body frame is vertical in every pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.camera_jacobian import fill_rotation_jacobian
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.point import Point

Array = NDArray[np.float64]

LEVEL_STD = 0.17  # rad; of the tilt of the camera: 10 degrees, a weak prior


@dataclass(frozen=True, eq=False)
class LevelCameras:
    """The term of the periodic objective.

    Attributes:
        weight: nu / N, weight of the squared tilt of a frame, m^2.
    """

    weight: float

    @staticmethod
    def build(frames: int, weight: float) -> LevelCameras:
        """Return the term of so many frames; the weight lambda in m^2 is that of a Gaussian prior."""
        return LevelCameras(weight / LEVEL_STD**2 / frames)

    def cost(self, point: Point) -> float:
        """Return the value of the term, m^2."""
        return self.weight * float((point.cameras.rotation[:, ::2, 2] ** 2).sum())

    def add_to(self, equations: PeriodicEquations, point: Point) -> None:
        """Add the matrix and the gradient, in place."""
        vertical = point.cameras.rotation[:, :, 2]
        jacobian = np.zeros((len(vertical), 3, 3))  # by the rotation vector; the scale has no influence
        fill_rotation_jacobian(jacobian, vertical)
        transposed = self.weight * np.swapaxes(jacobian[:, ::2], -1, -2)
        equations.camera_prior[:, :3, :3] += transposed @ jacobian[:, ::2]
        equations.camera_gradient[:, :3] += (transposed @ vertical[:, ::2, None])[..., 0]
