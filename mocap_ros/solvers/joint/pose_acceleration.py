# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The acceleration of the body's pose is small (beyond TPAMI 2016).

    sum_tl alpha_t (v_(t+1)l - v_tl)^2 / h_t,    v_t = (theta_(t+1) - theta_t) / dt_t

with alpha_t, h_t and dt_t as in `acceleration`. Base poses are orthonormal, so a weight's acceleration is that of
all joints together, and all weights count alike. For white acceleration of spectral density q in m^2 / s^3, alpha
would be 1e-4 m^2 / q; people have q = 0.4 to 1.4, but are at rest most of the time and then move suddenly, and the
image noise is correlated in time, so alpha was chosen on sequences (docs/solvers.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, kernel
from mocap_ros.solvers.joint.acceleration import Acceleration
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]

TYPICAL_M_S2 = 14.0  # m/s^2; A, over the root of the 15 joints 3.6 m/s^2, that of the joints of a walker


@dataclass(frozen=True, eq=False)
class PoseAcceleration(Acceleration):
    """The term of a batch; `weight` is alpha in s^3."""

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each three neighbours, counted for the earliest frame."""
        return _measure(self.factors, fit.state.theta)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling with the next two frames and the gradient, in place."""
        coupling = equations.coupling.diagonal
        _add(self.factors, fit.state.theta, equations.diagonal, coupling, equations.gradient)


@kernel(FLOATS_1D(FLOATS_2D, FLOATS_2D))
def _measure(factors: Array, theta: Array) -> Array:
    """Return the value of each three neighbours, (N,), counted for the earliest frame."""
    out = np.zeros(len(theta))
    for t in range(len(theta) - 2):
        a, b, c = factors[t, 0], factors[t, 1], factors[t, 2]
        for i in range(theta.shape[1]):
            change = a * theta[t, i] + b * theta[t + 1, i] + c * theta[t + 2, i]
            out[t] += change * change
    return out


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_2D))
def _add(factors: Array, theta: Array, diagonal: Array, coupling: Array, gradient: Array) -> None:
    """Add the term to the diagonal blocks (N, n, n), to the coupling (2, N, n) and to the gradient (N, n)."""
    for t in range(len(theta) - 2):
        c = factors[t]
        if c[0] == 0.0:
            continue
        for i in range(theta.shape[1]):
            change = c[0] * theta[t, i] + c[1] * theta[t + 1, i] + c[2] * theta[t + 2, i]
            for e in range(3):
                gradient[t + e, i] += c[e] * change
                diagonal[t + e, i, i] += c[e] * c[e]
                for d in range(1, 3 - e):
                    coupling[d - 1, t + e, i] += c[e] * c[e + d]
