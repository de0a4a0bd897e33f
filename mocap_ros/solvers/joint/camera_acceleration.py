"""The acceleration of the camera relative to the body is small (beyond TPAMI 2016).

    sum_t kappa_t |U_(t+1) - U_t|^2 / h_t,    U_t = (M_(t+1) - M_t) / dt_t,    M_t = s_t R_t[:2]

with kappa_t, h_t and dt_t as in `acceleration`. To the body the camera is what moves, so this is the acceleration
with which a person turns and comes nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, kernel
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.solvers.joint.acceleration import Acceleration
from mocap_ros.solvers.joint.camera_smoothness import (
    CAMERA_FEATURES,
    FEATURES,
    differentiate_features,
    measure_features,
)
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]

TYPICAL_PER_S2 = 3.0  # 1/s^2; A, the acceleration of a body that sways by 3 degrees once a second, and a half more


@dataclass(frozen=True, eq=False)
class CameraAcceleration(Acceleration):
    """The term of a batch; `weight` is kappa in m^2 s^3."""

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each three neighbours, counted for the earliest frame."""
        return _measure(self.factors, measure_features(fit.state.rotation, fit.state.log_scale))

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling with the next two cameras and the gradient, in place."""
        _add(
            self.factors,
            measure_features(fit.state.rotation, fit.state.log_scale),
            differentiate_features(fit.state.rotation, fit.state.log_scale),
            equations.diagonal,
            equations.coupling.corner,
            equations.gradient,
        )


def measure_matrices(rotation: Array, log_scale: Array) -> Array:
    """Return the elements of the matrices M_t, (N, 6), of rotations (N, 3, 3) and logarithms of the scale (N,)."""
    return measure_features(rotation, log_scale)[:, np.flatnonzero(CAMERA_FEATURES)]


@kernel(FLOATS_1D(FLOATS_2D, FLOATS_2D))
def _measure(factors: Array, features: Array) -> Array:
    """Return the value of each three neighbours, (N,), counted for the earliest frame."""
    out = np.zeros(len(features))
    for t in range(len(features) - 2):
        a, b, c = factors[t, 0], factors[t, 1], factors[t, 2]
        for f in range(FEATURES):
            if CAMERA_FEATURES[f]:
                change = a * features[t, f] + b * features[t + 1, f] + c * features[t + 2, f]
                out[t] += change * change
    return out


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_4D, FLOATS_2D))
def _add(
    factors: Array, features: Array, jacobian: Array, diagonal: Array, corner: Array, gradient: Array
) -> None:
    """Add the term to the diagonal blocks (N, n, n), the corners of the coupling (2, N, 4, 4) and the gradient."""
    k = gradient.shape[1] - CAMERA_UNKNOWNS
    for t in range(len(features) - 2):
        c = factors[t]
        if c[0] == 0.0:
            continue
        for f in range(FEATURES):
            if not CAMERA_FEATURES[f]:
                continue
            change = c[0] * features[t, f] + c[1] * features[t + 1, f] + c[2] * features[t + 2, f]
            for e in range(3):
                for i in range(CAMERA_UNKNOWNS):
                    gradient[t + e, k + i] += c[e] * change * jacobian[t + e, f, i]
                    for j in range(CAMERA_UNKNOWNS):
                        diagonal[t + e, k + i, k + j] += c[e] ** 2 * jacobian[t + e, f, i] * jacobian[t + e, f, j]
                        for d in range(1, 3 - e):
                            mixed = jacobian[t + e + d, f, i] * jacobian[t + e, f, j]
                            corner[d - 1, t + e, i, j] += c[e] * c[e + d] * mixed
