# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

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

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_2D, INPUT_1D, INPUT_2D, kernel
from mocap_ros.errors import InputError

Array = NDArray[np.float64]

# Accepted numbers of coefficients of each distortion model.
COEFFICIENT_COUNTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8,), 'equidistant': (4,)}

UNDISTORT_ITERATIONS = 20  # iterations; inverts the lenses of tests/geometry to within 1e-6 of a focal length
MAX_RAY_ANGLE = 1.5  # rad from the optical axis; a pinhole camera cannot show rays at pi / 2 and beyond
MIN_RADIUS = 1e-12  # focal lengths; guards the divisions by the radius at the optical axis
ANGLE_STEP = 1e-6  # rad; step of the central difference, far below any pixel
MIN_SLOPE = 1e-3  # 1; guards the Newton step where the fisheye polynomial is flat
MAX_RAY = math.tan(MAX_RAY_ANGLE)  # 1; largest x / z or y / z of a ray
MAX_NAME_CHARACTERS = 60  # of an unknown model in an error


@kernel(FLOAT(FLOAT, INPUT_1D))
def _distort_angle(angle: float, lens: Array) -> float:
    a2 = angle * angle
    return angle * (1 + a2 * (lens[1] + a2 * (lens[2] + a2 * (lens[3] + a2 * lens[4]))))


@kernel(types.UniTuple(FLOAT, 2)(FLOAT, FLOAT, INPUT_1D))
def _distort_point(x: float, y: float, lens: Array) -> tuple[float, float]:
    """Return where a lens with these `Distortion.parameters` shows the normalised point (x, y)."""
    if lens[0] == 1.0:
        radius = math.hypot(x, y)
        factor = _distort_angle(math.atan(radius), lens) / max(radius, MIN_RADIUS)
        return x * factor, y * factor
    k1, k2, p1, p2, k3, k4, k5, k6 = lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7], lens[8]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return x * radial + dx, y * radial + dy


@kernel(types.UniTuple(FLOAT, 2)(FLOAT, FLOAT, INPUT_1D))
def undistort_point(x: float, y: float, lens: Array) -> tuple[float, float]:
    """Return the normalised point that a lens with these `Distortion.parameters` shows at (x, y)."""
    if lens[0] == 1.0:
        shown = math.hypot(x, y)
        angle = min(shown, MAX_RAY_ANGLE)
        for _ in range(UNDISTORT_ITERATIONS):
            difference = _distort_angle(angle + ANGLE_STEP, lens) - _distort_angle(angle - ANGLE_STEP, lens)
            slope = difference / (2 * ANGLE_STEP)
            step = (_distort_angle(angle, lens) - shown) / (slope if abs(slope) > MIN_SLOPE else 1.0)
            angle = min(max(angle - step, 0.0), MAX_RAY_ANGLE)
        factor = math.tan(angle) / max(shown, MIN_RADIUS)
        return x * factor, y * factor
    px, py = x, y
    for _ in range(UNDISTORT_ITERATIONS):
        dx, dy = _distort_point(px, py, lens)
        closer_x, closer_y = px - (dx - x), py - (dy - y)
        is_valid = abs(closer_x) < MAX_RAY and abs(closer_y) < MAX_RAY  # and a number
        if not is_valid or (closer_x == px and closer_y == py):
            break
        px, py = closer_x, closer_y
    return px, py


@kernel(FLOATS_2D(INPUT_2D, INPUT_1D))
def _distort_points(points: Array, lens: Array) -> Array:
    out = np.empty_like(points)
    for n in range(len(points)):
        out[n, 0], out[n, 1] = _distort_point(points[n, 0], points[n, 1], lens)
    return out


@kernel(FLOATS_2D(INPUT_2D, INPUT_1D))
def _undistort_points(points: Array, lens: Array) -> Array:
    out = np.empty_like(points)
    for n in range(len(points)):
        out[n, 0], out[n, 1] = undistort_point(points[n, 0], points[n, 1], lens)
    return out


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

        No coefficients, or only zeros, mean no distortion, whatever the name is. OpenCV's rational model may have
        four more, of a thin prism, and two more, of a tilted sensor. These, and all beyond those of the model, may
        only be 0.

        Raises:
            InputError: The model is unknown, has another number of coefficients, or one of them is not finite.
        """
        if not any(coefficients):
            return Distortion()
        if model not in COEFFICIENT_COUNTS:
            raise InputError(
                f'distortion model {model[:MAX_NAME_CHARACTERS]!r}: expected {", ".join(COEFFICIENT_COUNTS)}'
            )
        counts = COEFFICIENT_COUNTS[model]
        if not any(coefficients[max(counts) :]):
            coefficients = coefficients[: max(counts)]
        if len(coefficients) not in counts:
            expected = ' or '.join(map(str, counts))
            raise InputError(f'distortion: {model} takes {expected} coefficients, not {len(coefficients)}')
        if not np.isfinite(coefficients).all():
            raise InputError('distortion: a coefficient is not finite')
        return Distortion(model, coefficients)

    @cached_property
    def parameters(self) -> Array:
        """(9,) 1 for a fisheye lens, else 0; then the coefficients in their order, and 0 for those it has not."""
        is_fisheye = self.model == 'equidistant'
        return np.array([is_fisheye, *self.coefficients, *[0.0] * (8 - len(self.coefficients))], float)

    def distort(self, points: Array) -> Array:
        """Convert normalised points (..., 2) of a pinhole camera to those (..., 2) that the lens shows."""
        if not self.coefficients:
            return points
        flat = np.ascontiguousarray(points, float).reshape(-1, 2)
        return np.asarray(_distort_points(flat, self.parameters).reshape(points.shape))

    def undistort(self, points: Array) -> Array:
        """Convert normalised points (..., 2) shown by the lens to points (..., 2) of a pinhole camera.

        The equidistant model is inverted by Newton's method, the others by fixed-point iteration. Where the lens
        model is not invertible, the result is the last iterate that was finite and within `MAX_RAY_ANGLE`.
        """
        if not self.coefficients:
            return points
        flat = np.ascontiguousarray(points, float).reshape(-1, 2)
        return np.asarray(_undistort_points(flat, self.parameters).reshape(points.shape))


NO_DISTORTION = Distortion()  # distortion of an ideal pinhole camera, the default of `Intrinsics`
