# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Lens distortion: converts between the image points of a pinhole camera and those of a real lens.

With x = (u - cx) / fx, y = (v - cy) / fy, r^2 = x^2 + y^2 and theta = atan(r), a lens shows (x, y) at (x_d, y_d):

    c = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)    plumb_bob (k1 k2 p1 p2 [k3]) and
    x_d = x c + 2 p1 x y + p2 (r^2 + 2 x^2)                                rational_polynomial (and k4 k5 k6)
    y_d = y c + p1 (r^2 + 2 y^2) + 2 p2 x y

    (x_d, y_d) = (x, y) theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) / r        equidistant

Models and order of the coefficients are those of `sensor_msgs/CameraInfo` and OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.errors import InputError

MAX_PLUMB_BOB_COEFFICIENTS = 5  # OpenCV's k1, k2, p1, p2, k3; with more coefficients the model is rational
# Accepted numbers of coefficients of each distortion model.
COEFFICIENT_COUNTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8,), 'equidistant': (4,)}

# Other names of the models, without regard to case and separators.
MODEL_BY_SYNONYM = {
    '': 'plumb_bob', 'plumbbob': 'plumb_bob', 'radtan': 'plumb_bob',
    'radialtangential': 'plumb_bob', 'brownconrady': 'plumb_bob',
    'opencv': 'plumb_bob', 'rational': 'rational_polynomial', 'rationalpolynomial': 'rational_polynomial',
    'equidistant': 'equidistant', 'equidist': 'equidistant', 'fisheye': 'equidistant',
    'opencvfisheye': 'equidistant', 'kannalabrandt': 'equidistant', 'kannalabrandt4': 'equidistant',
}  # fmt: skip
MAX_RAY_ANGLE = 1.5  # rad from the optical axis; a pinhole camera cannot show rays at pi / 2 and beyond

MAX_NAME_CHARACTERS = 60  # of an unknown model in an error


@dataclass(frozen=True)
class Distortion:
    """Distortion of a lens; a `Distortion` without coefficients leaves points as they are."""

    model: str = 'plumb_bob'  # name of the distortion model, a key of `COEFFICIENT_COUNTS`
    coefficients: tuple[float, ...] = ()  # coefficients in the order of CameraInfo's `d`; empty for no distortion

    @staticmethod
    def from_coefficients(model: str, coefficients: tuple[float, ...]) -> Distortion:
        """Return the distortion; no coefficients, or only zeros, mean none, whatever the name is.

        Models have other names as well, such as `fisheye` for `equidistant`, and a `plumb_bob` with more than five
        coefficients is rational, as in OpenCV. Coefficients beyond those of the model may only be 0.

        Raises:
            InputError: The model is unknown, has another number of coefficients, or one of them is not finite.
        """
        if not any(coefficients):
            return Distortion()
        model = MODEL_BY_SYNONYM.get(''.join(filter(str.isalnum, model.lower())), model)
        if model == 'plumb_bob' and len(coefficients) > MAX_PLUMB_BOB_COEFFICIENTS:
            model = 'rational_polynomial'  # as OpenCV takes the same coefficients
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
        return engine.distort_points(flat, self.parameters).reshape(points.shape)

    def undistort(self, points: Array) -> Array:
        """Convert normalised points (..., 2) shown by the lens to points (..., 2) of a pinhole camera.

        Where the model is not invertible, the last iterate that was finite and within `MAX_RAY_ANGLE` is returned.
        """
        if not self.coefficients:
            return points
        flat = np.ascontiguousarray(points, float).reshape(-1, 2)
        return engine.undistort_points(flat, self.parameters).reshape(points.shape)


NO_DISTORTION = Distortion()  # distortion of an ideal pinhole camera, the default of `Intrinsics`
