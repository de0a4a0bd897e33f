"""The pinhole camera with lens distortion: pixels to rays and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import NO_DISTORTION, Distortion

Array = NDArray[np.float64]


LARGEST_PX = 1e6


@dataclass(frozen=True)
class Intrinsics:
    """A camera.

    Attributes:
        focal: px, geometric mean of both focal lengths.
        center: (cx, cy) px.
        known: False where the focal length is only nominal.
        aspect: fy / fx.
        distortion: of the lens.
    """

    focal: float
    center: tuple[float, float]
    known: bool
    aspect: float = 1.0
    distortion: Distortion = NO_DISTORTION

    def rays(self, points: Array) -> Array:
        """(..., 2) px -> (..., 2) x / z and y / z of the ray through each point, distortion undone."""
        fx, fy = self.focal / self.aspect**0.5, self.focal * self.aspect**0.5
        return self.distortion.undistort((points - np.array(self.center)) / np.array([fx, fy]))

    def project(self, points: Array) -> Array:
        """(..., 3) m, optical frame, z > 0 -> (..., 2) px."""
        fx, fy = self.focal / self.aspect**0.5, self.focal * self.aspect**0.5
        seen = self.distortion.distort(points[..., :2] / points[..., 2:])
        return np.asarray(seen * np.array([fx, fy]) + np.array(self.center))

    @staticmethod
    def nominal(width: int, height: int, focal_in_widths: float) -> Intrinsics:
        """A guess from the image size alone."""
        return Intrinsics(focal_in_widths * width, (width / 2, height / 2), known=False)

    @staticmethod
    def from_matrix(matrix: Array, distortion: Distortion = NO_DISTORTION) -> Intrinsics:
        """From a (3, 3) camera matrix in px and the distortion of the lens.

        Raises:
            InputError: a focal length outside 1 to `LARGEST_PX`, or a principal point beyond it.
        """
        focal_lengths, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if not ((focal_lengths >= 1) & (focal_lengths <= LARGEST_PX)).all():
            raise InputError(f'focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px')
        if not (np.abs(centre) <= LARGEST_PX).all():
            raise InputError(f'principal point {centre[0]:g}, {centre[1]:g} px')
        focal = float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
        aspect = float(matrix[1, 1] / matrix[0, 0])
        return Intrinsics(focal, (float(matrix[0, 2]), float(matrix[1, 2])), True, aspect, distortion)
