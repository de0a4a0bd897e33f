# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The acceleration with which a person turns before the camera is small (beyond TPAMI 2016).

    sum_t kappa_t |U_(t+1) - U_t|^2 / h_t,    U_t = (M_(t+1) - M_t) / dt_t,    M_t = R_t[:2]

with kappa_t, h_t and dt_t as in `acceleration`. The scale does not count: where the image says little, a
scale that falls to nothing or goes on changing at the same rate would cost nothing, and the solution would drift
away from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, kernel
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, write_point_jacobian
from mocap_ros.solvers.joint.acceleration import Acceleration
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]

TYPICAL_PER_S2 = 4.2  # 1/s^2; A, the acceleration of a body that sways by 4 degrees once a second, and a half more
ELEMENTS = 6  # of M


@dataclass(frozen=True, eq=False)
class CameraAcceleration(Acceleration):
    """The term of a batch; `weight` is kappa in m^2 s^3."""

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each three neighbours, counted for the earliest frame."""
        return _measure(self.factors, measure_directions(fit.state.rotation))

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling with the next two cameras and the gradient, in place."""
        _add(
            self.factors,
            measure_directions(fit.state.rotation),
            _differentiate(fit.state.rotation),
            equations.diagonal,
            equations.coupling.corner,
            equations.gradient,
        )


def measure_directions(rotation: Array) -> Array:
    """Return the elements (N, 6) of the matrices M_t of rotations (N, 3, 3)."""
    return np.ascontiguousarray(rotation[:, :2]).reshape(len(rotation), ELEMENTS)


@kernel(FLOATS_3D(FLOATS_3D))
def _differentiate(rotation: Array) -> Array:
    """Return the derivatives (N, 6, 3) of the elements of M by the rotation vector."""
    out = np.empty((len(rotation), ELEMENTS, 3))
    point, block = np.empty(3), np.empty((3, CAMERA_UNKNOWNS))
    for t in range(len(rotation)):
        for column in range(3):
            for i in range(3):
                point[i] = rotation[t, i, column]
            write_point_jacobian(point, block, 0, 0)
            for row in range(2):
                for unknown in range(3):
                    out[t, 3 * row + column, unknown] = block[row, unknown]
    return out


@kernel(FLOATS_1D(FLOATS_2D, FLOATS_2D))
def _measure(factors: Array, directions: Array) -> Array:
    """Return the value of each three neighbours, (N,), counted for the earliest frame."""
    out = np.zeros(len(directions))
    for t in range(len(directions) - 2):
        a, b, c = factors[t, 0], factors[t, 1], factors[t, 2]
        for f in range(ELEMENTS):
            change = a * directions[t, f] + b * directions[t + 1, f] + c * directions[t + 2, f]
            out[t] += change * change
    return out


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_4D, FLOATS_2D))
def _add(
    factors: Array, directions: Array, jacobian: Array, diagonal: Array, corner: Array, gradient: Array
) -> None:
    """Add the term to the diagonal blocks (N, n, n), the corners of the coupling (2, N, 4, 4) and the gradient."""
    k = gradient.shape[1] - CAMERA_UNKNOWNS
    for t in range(len(directions) - 2):
        c = factors[t]
        if c[0] == 0.0:
            continue
        for f in range(ELEMENTS):
            change = c[0] * directions[t, f] + c[1] * directions[t + 1, f] + c[2] * directions[t + 2, f]
            for e in range(3):
                for i in range(3):
                    gradient[t + e, k + i] += c[e] * change * jacobian[t + e, f, i]
                    for j in range(3):
                        diagonal[t + e, k + i, k + j] += c[e] ** 2 * jacobian[t + e, f, i] * jacobian[t + e, f, j]
                        for d in range(1, 3 - e):
                            mixed = jacobian[t + e + d, f, i] * jacobian[t + e, f, j]
                            corner[d - 1, t + e, i, j] += c[e] * c[e + d] * mixed
