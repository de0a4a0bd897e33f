"""Lens distortion: converts between the image points of a pinhole camera and those of a real lens.

Points are normalised: x = (u - cx) / fx, y = (v - cy) / fy. With r^2 = x^2 + y^2 and theta = atan(r), a lens shows
the pinhole point (x, y) at (x_d, y_d). For `plumb_bob` and `rational_polynomial`:

    c = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    x_d = x c + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_d = y c + p1 (r^2 + 2 y^2) + 2 p2 x y

For `equidistant`:

    (x_d, y_d) = (x, y) theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) / r

The models and the order of the coefficients are those of `sensor_msgs/CameraInfo` and OpenCV: `plumb_bob` has
(k1 k2 p1 p2 [k3]), `rational_polynomial` the same and (k4 k5 k6), `equidistant` (k1 k2 k3 k4, for fisheye lenses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError

Array = NDArray[np.float64]

# Accepted numbers of coefficients of each distortion model.
COEFFICIENT_COUNTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8,), 'equidistant': (4,)}

UNDISTORT_ITERATIONS = 20  # iterations; inverts the lenses of tests/geometry to within 1e-6 of a focal length
MAX_RAY_ANGLE = 1.5  # rad from the optical axis; a pinhole camera cannot show rays at pi / 2 and beyond
MIN_RADIUS = 1e-12  # focal lengths; guards the divisions by the radius at the optical axis
ANGLE_STEP = 1e-6  # rad; step of the central difference, far below any pixel
MIN_SLOPE = 1e-3  # 1; guards the Newton step where the fisheye polynomial is flat


@dataclass(frozen=True)
class Distortion:
    """Distortion of a lens; a `Distortion` without coefficients leaves points as they are.

    Attributes:
        model: name of the distortion model, a key of `COEFFICIENT_COUNTS`.
        coefficients: coefficients in the order of CameraInfo's `d`; empty for no distortion.
    """

    model: str = 'plumb_bob'
    coefficients: tuple[float, ...] = ()

    @staticmethod
    def from_coefficients(model: str, coefficients: tuple[float, ...]) -> Distortion:
        """Check a model name and its coefficients and return the distortion.

        No coefficients, or only zeros, mean no distortion, whatever the model name is.

        Raises:
            InputError: The model is unknown, has another number of coefficients, or one of them is not finite.
        """
        if not any(coefficients):
            return Distortion()
        if model not in COEFFICIENT_COUNTS:
            raise InputError(f'distortion model {model!r:.60}: expected {", ".join(COEFFICIENT_COUNTS)}')
        if len(coefficients) not in COEFFICIENT_COUNTS[model]:
            expected = ' or '.join(map(str, COEFFICIENT_COUNTS[model]))
            raise InputError(f'distortion: {model} takes {expected} coefficients, not {len(coefficients)}')
        if not np.isfinite(coefficients).all():
            raise InputError('distortion: a coefficient is not finite')
        return Distortion(model, coefficients)

    def distort(self, points: Array) -> Array:
        """Convert normalised points (..., 2) of a pinhole camera to those (..., 2) that the lens shows."""
        if not self.coefficients:
            return points
        x, y = points[..., 0], points[..., 1]
        if self.model == 'equidistant':
            radius = np.hypot(x, y)
            return points * (self._distort_angle(np.arctan(radius)) / np.maximum(radius, MIN_RADIUS))[..., None]
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.coefficients, *(0.0,) * (8 - len(self.coefficients)))
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([x * radial + dx, y * radial + dy], axis=-1)

    def undistort(self, points: Array) -> Array:
        """Convert normalised points (..., 2) shown by the lens to points (..., 2) of a pinhole camera.

        The equidistant model is inverted by Newton's method, the others by fixed-point iteration. Where the lens
        model is not invertible, the result is the last iterate that was finite and within `MAX_RAY_ANGLE`.
        """
        if not self.coefficients:
            return points
        if self.model == 'equidistant':
            return self._undistort_equidistant(points)
        pinhole = points
        for _ in range(UNDISTORT_ITERATIONS):
            with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
                closer = pinhole - (self.distort(pinhole) - points)
            is_valid = np.isfinite(closer).all(axis=-1) & (np.abs(closer).max(axis=-1) < np.tan(MAX_RAY_ANGLE))
            pinhole = np.where(is_valid[..., None], closer, pinhole)
        return np.asarray(pinhole)

    def _undistort_equidistant(self, points: Array) -> Array:
        shown = np.hypot(points[..., 0], points[..., 1])
        angle = np.minimum(shown, MAX_RAY_ANGLE)
        for _ in range(UNDISTORT_ITERATIONS):
            difference = self._distort_angle(angle + ANGLE_STEP) - self._distort_angle(angle - ANGLE_STEP)
            slope = difference / (2 * ANGLE_STEP)
            step = (self._distort_angle(angle) - shown) / np.where(np.abs(slope) > MIN_SLOPE, slope, 1.0)
            angle = np.clip(angle - step, 0.0, MAX_RAY_ANGLE)
        return np.asarray(points * (np.tan(angle) / np.maximum(shown, MIN_RADIUS))[..., None])

    def _distort_angle(self, angle: Array) -> Array:
        """Return the distorted angle, theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), in rad."""
        k1, k2, k3, k4 = self.coefficients
        a2 = angle * angle
        return np.asarray(angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))))


NO_DISTORTION = Distortion()  # distortion of an ideal pinhole camera, the default of `Intrinsics`
