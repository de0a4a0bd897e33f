"""The acceleration of the camera relative to the body is small (beyond TPAMI 2016).

    kappa sum_t |U_(t+1) - U_t|^2 / h_t
    U_t = (M_(t+1) - M_t) / dt_t,    M_t = s_t R_t[:2],    h_t = (dt_t + dt_(t+1)) / 2

with dt_t the time from frame t to the next, as for the poses (`pose_acceleration`). To the body the camera is what
moves, so this is the acceleration with which a person turns and comes nearer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, kernel
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.solvers.joint.batch import VELOCITY_CHANGE_FRAMES, Subsample
from mocap_ros.solvers.joint.camera_smoothness import (
    CAMERA_FEATURES,
    FEATURES,
    differentiate_features,
    measure_features,
)
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CameraAcceleration:
    """The term of a batch.

    Attributes:
        weight: m^2 s^3, kappa.
        velocity_change: (N, 3) as `Batch.velocity_change`.
    """

    weight: float
    velocity_change: Array

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each three neighbours, counted for the earliest frame."""
        features = measure_features(fit.state.rotation, fit.state.log_scale)
        return _measure(self.weight, self.velocity_change, features)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling with the next two cameras and the gradient, in place."""
        _add(
            self.weight,
            self.velocity_change,
            measure_features(fit.state.rotation, fit.state.log_scale),
            differentiate_features(fit.state.rotation, fit.state.log_scale),
            equations.diagonal,
            equations.coupling.corner,
            equations.gradient,
        )

    def subsampled(self, kept: Subsample) -> CameraAcceleration:
        """Return a term of value 0 for some frames: too far apart, they tell nothing of accelerations."""
        return replace(self, velocity_change=np.zeros((len(kept.frames), VELOCITY_CHANGE_FRAMES)))

    def with_components(self, k: int) -> CameraAcceleration:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the base poses."""
        return self


@kernel(FLOATS_1D(FLOAT, FLOATS_2D, FLOATS_2D))
def _measure(weight: float, velocity_change: Array, features: Array) -> Array:
    """Return the value of each three neighbours, (N,), counted for the earliest frame."""
    out = np.zeros(len(features))
    for t in range(len(features) - 2):
        a, b, c = velocity_change[t, 0], velocity_change[t, 1], velocity_change[t, 2]
        for f in range(FEATURES):
            if CAMERA_FEATURES[f]:
                change = a * features[t, f] + b * features[t + 1, f] + c * features[t + 2, f]
                out[t] += weight * change * change
    return out


@kernel(void(FLOAT, FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_4D, FLOATS_2D))
def _add(
    weight: float,
    velocity_change: Array,
    features: Array,
    jacobian: Array,
    diagonal: Array,
    corner: Array,
    gradient: Array,
) -> None:
    """Add the term to the diagonal blocks (N, n, n), the corners of the coupling (2, N, 4, 4) and the gradient."""
    k = gradient.shape[1] - CAMERA_UNKNOWNS
    for t in range(len(features) - 2):
        factors = velocity_change[t]
        if factors[0] == 0.0:
            continue
        for f in range(FEATURES):
            if not CAMERA_FEATURES[f]:
                continue
            change = (
                factors[0] * features[t, f] + factors[1] * features[t + 1, f] + factors[2] * features[t + 2, f]
            )
            for e in range(3):
                pull = weight * factors[e]
                for i in range(CAMERA_UNKNOWNS):
                    gradient[t + e, k + i] += pull * change * jacobian[t + e, f, i]
                    for j in range(CAMERA_UNKNOWNS):
                        own = jacobian[t + e, f, i] * jacobian[t + e, f, j]
                        diagonal[t + e, k + i, k + j] += pull * factors[e] * own
                        for d in range(1, 3 - e):
                            mixed = jacobian[t + e + d, f, i] * jacobian[t + e, f, j]
                            corner[d - 1, t + e, i, j] += pull * factors[e + d] * mixed
