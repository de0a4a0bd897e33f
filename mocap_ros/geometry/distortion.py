"""Lens distortion: from where a point is seen to where a pinhole camera would see it.

The models are those of `sensor_msgs/CameraInfo`: `plumb_bob` (k1 k2 p1 p2 k3), `rational_polynomial` (the same and
k4 k5 k6) and `equidistant` (k1 k2 k3 k4, fisheye). Points are normalised: (u - cx) / fx, (v - cy) / fy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError

Array = NDArray[np.float64]

COEFFICIENTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8,), 'equidistant': (4,)}
ROUNDS = 20
WIDEST_ANGLE = 1.5


@dataclass(frozen=True)
class Distortion:
    """Of a lens; without coefficients, none.

    Attributes:
        model: a key of `COEFFICIENTS`.
        coefficients: in the order of OpenCV and of CameraInfo's `d`.
    """

    model: str = 'plumb_bob'
    coefficients: tuple[float, ...] = ()

    @staticmethod
    def named(model: str, coefficients: tuple[float, ...]) -> Distortion:
        """Checked; no model name or no coefficients, or only zeros, mean none.

        Raises:
            InputError: a model that is not known, a wrong number of coefficients, or one not finite.
        """
        if not any(coefficients):
            return Distortion()
        if model not in COEFFICIENTS:
            raise InputError(f'distortion model {model!r:.60}: expected {", ".join(COEFFICIENTS)}')
        if len(coefficients) not in COEFFICIENTS[model]:
            expected = ' or '.join(map(str, COEFFICIENTS[model]))
            raise InputError(f'distortion: {model} takes {expected} coefficients, not {len(coefficients)}')
        if not np.isfinite(coefficients).all():
            raise InputError('distortion: a coefficient is not finite')
        return Distortion(model, coefficients)

    def distort(self, points: Array) -> Array:
        """(..., 2) points of a pinhole camera -> where this lens shows them."""
        if not self.coefficients:
            return points
        x, y = points[..., 0], points[..., 1]
        if self.model == 'equidistant':
            radius = np.hypot(x, y)
            return points * (self._fisheye(np.arctan(radius)) / np.maximum(radius, 1e-12))[..., None]
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.coefficients, *(0.0,) * (8 - len(self.coefficients)))
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([x * radial + dx, y * radial + dy], axis=-1)

    def undistort(self, points: Array) -> Array:
        """(..., 2) points as this lens shows them -> those of a pinhole camera, by fixed-point iteration.

        Beyond the angle at which the lens model folds over, the point of the last step that stayed finite.
        """
        if not self.coefficients:
            return points
        if self.model == 'equidistant':
            shown = np.hypot(points[..., 0], points[..., 1])
            angle = np.minimum(shown, WIDEST_ANGLE)
            for _ in range(ROUNDS):
                slope = (self._fisheye(angle + 1e-6) - self._fisheye(angle - 1e-6)) / 2e-6
                step = (self._fisheye(angle) - shown) / np.where(np.abs(slope) > 1e-3, slope, 1.0)
                angle = np.clip(angle - step, 0.0, WIDEST_ANGLE)
            return np.asarray(points * (np.tan(angle) / np.maximum(shown, 1e-12))[..., None])
        pinhole = points
        for _ in range(ROUNDS):
            with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
                closer = pinhole - (self.distort(pinhole) - points)
            sane = np.isfinite(closer).all(axis=-1) & (np.abs(closer).max(axis=-1) < np.tan(WIDEST_ANGLE))
            pinhole = np.where(sane[..., None], closer, pinhole)
        return np.asarray(pinhole)

    def _fisheye(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.coefficients
        a2 = angle * angle
        return np.asarray(angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))))


NO_DISTORTION = Distortion()
