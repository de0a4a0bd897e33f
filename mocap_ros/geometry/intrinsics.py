# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Camera intrinsics: pixels u = fx x_d + cx, v = fy y_d + cy, and rays.

(x_d, y_d) is the distorted image of the ray (x, y) = (X / Z, Y / Z), with X, Y, Z in the camera's optical frame (x
right, y down, z forward).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.distortion import NO_DISTORTION, Distortion

# px; focal lengths and principal points of a CameraInfo beyond it are refused, far above those of any real camera
MAX_INTRINSIC_PX = 1e6


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsic parameters of a camera."""

    focal: float  # focal length in px, the geometric mean of fx and fy
    center: tuple[float, float]  # (cx, cy) principal point in px
    is_focal_known: bool  # False if the focal length is only nominal
    aspect: float = 1.0
    distortion: Distortion = NO_DISTORTION
    # width and height in px of the images; None if they are unknown. Cameras that differ in nothing else are the
    # same
    image_size: tuple[int, int] | None = field(default=None, compare=False)

    @cached_property
    def focal_lengths(self) -> Array:
        """(fx, fy) in px."""
        return np.array([self.focal / self.aspect**0.5, self.focal * self.aspect**0.5])

    @cached_property
    def center_array(self) -> Array:
        """(cx, cy) in px."""
        return np.array(self.center)

    def pixels_to_rays(self, points: Array) -> Array:
        """Convert image points (..., 2) in px to undistorted rays (..., 2), each as x / z and y / z."""
        return self.distortion.undistort((points - self.center_array) / self.focal_lengths)

    def project(self, points: Array) -> Array:
        """Project points (..., 3) in m, optical frame, z > 0, to image points (..., 2) in px."""
        distorted = self.distortion.distort(points[..., :2] / points[..., 2:])
        return np.asarray(distorted * self.focal_lengths + self.center_array)

    def resize_like(self, other: Intrinsics) -> Intrinsics:
        """Return these intrinsics for images that are resized to those of another camera.

        The ratio of the widths enlarges the image, which is cropped or extended alike above and below.
        """
        if self.image_size is None or other.image_size in (None, self.image_size):
            return self
        old, new = np.array(self.image_size), np.array(other.image_size)
        scale = float(new[0] / old[0])
        x, y = new / 2 + scale * (self.center_array - old / 2)
        return replace(self, focal=scale * self.focal, center=(float(x), float(y)), image_size=other.image_size)

    @staticmethod
    def from_image_size(width: int, height: int, focal_in_sides: float) -> Intrinsics:
        """Return nominal intrinsics, of a focal length of `focal_in_sides` times the longer side of the image."""
        nominal = Intrinsics.centred(focal_in_sides * max(width, height), (width, height))
        return replace(nominal, is_focal_known=False)

    @staticmethod
    def centred(focal: float, image_size: tuple[int, int]) -> Intrinsics:
        """Return intrinsics of a known focal length in px, with the principal point in the middle of the image."""
        width, height = image_size
        return Intrinsics(focal, (width / 2, height / 2), is_focal_known=True, image_size=image_size)

    @staticmethod
    def from_matrix(
        matrix: Array, distortion: Distortion = NO_DISTORTION, image_size: tuple[int, int] | None = None
    ) -> Intrinsics:
        """Return the intrinsics of a (3, 3) camera matrix in px, the distortion of the lens and the image size.

        Raises:
            InputError: A focal length or a coordinate of the principal point is beyond `MAX_INTRINSIC_PX`.
        """
        focal_lengths, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if not ((focal_lengths >= 1) & (focal_lengths <= MAX_INTRINSIC_PX)).all():
            raise InputError(
                f'focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px, expected 1 to {MAX_INTRINSIC_PX:g} px'
            )
        if not (np.abs(centre) <= MAX_INTRINSIC_PX).all():
            raise InputError(
                f'principal point {centre[0]:g}, {centre[1]:g} px, expected at most {MAX_INTRINSIC_PX:g} px'
            )
        focal = float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
        aspect = float(matrix[1, 1] / matrix[0, 0])
        centre_px = float(matrix[0, 2]), float(matrix[1, 2])
        return Intrinsics(focal, centre_px, True, aspect, distortion, image_size)


def recover_intrinsics(roots: Array, scale: Array, translation: Array) -> Intrinsics:
    """Return the camera, without distortion, of which weak-perspective cameras are known.

        f = median s z,  c = median (t - f (x, y) / z)

    of roots (N, 3) m, means (x, y, z) of the joints, scales s (N,) px/m and translations t (N, 2) px. The
    principal point is in the middle of its image. InputError where they are not those of a camera.
    """
    is_known = np.isfinite(np.column_stack([roots, scale, translation])).all(axis=1)
    if not is_known.any():
        raise InputError('scale, translation: not finite in any frame')
    roots, scale, translation = roots[is_known], scale[is_known], translation[is_known]
    focal = float(np.median(scale * roots[:, 2]))
    x, y = np.median(translation - focal * roots[:, :2] / roots[:, 2:], axis=0).tolist()
    if not (np.isfinite([focal, x, y]).all() and focal >= 1):
        raise InputError('scale, translation: not those of a camera')
    size = max(round(2 * x), 1), max(round(2 * y), 1)
    return Intrinsics(focal, (x, y), is_focal_known=False, image_size=size)
