"""The acceleration of the body's pose is small (beyond TPAMI 2016).

    alpha sum_tl (v_(t+1)l - v_tl)^2 / h_t
    v_t = (theta_(t+1) - theta_t) / dt_t,    h_t = (dt_t + dt_(t+1)) / 2

with dt_t the time from frame t to the next. The sum is the integral of the squared accelerations over time, so it
does not depend on the frame rate. Base poses are orthonormal, so a weight's acceleration is that of all joints
together, and all weights count alike. For white acceleration of spectral density q in m^2 / s^3, alpha would be
1e-4 m^2 / q; people have q = 0.4 to 1.4, but are at rest most of the time and then move suddenly, and the image
noise is correlated in time, so alpha was chosen on sequences (docs/solvers.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, FLOATS_3D, kernel
from mocap_ros.solvers.joint.batch import VELOCITY_CHANGE_FRAMES, Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseAcceleration:
    """The term of a batch.

    Attributes:
        weight: s^3, alpha.
        velocity_change: (N, 3) as `Batch.velocity_change`.
    """

    weight: float
    velocity_change: Array

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each three neighbours, counted for the earliest frame."""
        return _measure(self.weight, self.velocity_change, fit.state.theta)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling with the next two frames and the gradient, in place."""
        _add(
            self.weight,
            self.velocity_change,
            fit.state.theta,
            equations.diagonal,
            equations.coupling.diagonal,
            equations.gradient,
        )

    def subsampled(self, kept: Subsample) -> PoseAcceleration:
        """Return a term of value 0 for some frames: too far apart, they tell nothing of accelerations."""
        return replace(self, velocity_change=np.zeros((len(kept.frames), VELOCITY_CHANGE_FRAMES)))

    def with_components(self, k: int) -> PoseAcceleration:  # noqa: ARG002, part of the protocol
        """Return the term itself, which counts all weights alike."""
        return self


@kernel(FLOATS_1D(FLOAT, FLOATS_2D, FLOATS_2D))
def _measure(weight: float, velocity_change: Array, theta: Array) -> Array:
    """Return the value of each three neighbours, (N,), counted for the earliest frame."""
    out = np.zeros(len(theta))
    for t in range(len(theta) - 2):
        a, b, c = velocity_change[t, 0], velocity_change[t, 1], velocity_change[t, 2]
        for i in range(theta.shape[1]):
            change = a * theta[t, i] + b * theta[t + 1, i] + c * theta[t + 2, i]
            out[t] += weight * change * change
    return out


@kernel(void(FLOAT, FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_2D))
def _add(
    weight: float, velocity_change: Array, theta: Array, diagonal: Array, coupling: Array, gradient: Array
) -> None:
    """Add the term to the diagonal blocks (N, n, n), to the coupling (2, N, n) and to the gradient (N, n)."""
    for t in range(len(theta) - 2):
        factors = velocity_change[t]
        if factors[0] == 0.0:
            continue
        for i in range(theta.shape[1]):
            change = factors[0] * theta[t, i] + factors[1] * theta[t + 1, i] + factors[2] * theta[t + 2, i]
            for e in range(3):
                pull = weight * factors[e]
                gradient[t + e, i] += pull * change
                diagonal[t + e, i, i] += pull * factors[e]
                for d in range(1, 3 - e):
                    coupling[d - 1, t + e, i] += pull * factors[e + d]
