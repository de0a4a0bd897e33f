# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The smoothness of the base-pose weights over time (beyond TPAMI 2016).

    mu sum_tl ((theta_tl - theta_(t-1)l) / sigma_l)^2 / dt_t

with sigma_l the standard deviation of weight l over the training poses, and dt_t the time between the two frames,
so that the term does not depend on the frame rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, kernel
from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseSmoothness:
    """The term of a batch.

    Attributes:
        weight: (N - 1,) mu / dt of each pair of neighbouring frames, 0 between two sequences.
    """

    weight: Array

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each pair of neighbours, counted for the earlier frame."""
        return _measure_change(self.weight, fit.model.std, fit.state.theta)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling of neighbours and the gradient, in place."""
        _add_change(
            self.weight,
            fit.model.std,
            fit.state.theta,
            equations.diagonal,
            equations.coupling.diagonal,
            equations.gradient,
        )

    def subsampled(self, kept: Subsample) -> PoseSmoothness:
        """Return the term of some frames only."""
        return replace(self, weight=self.weight[kept.pairs] * kept.pair_factor)

    def with_components(self, k: int) -> PoseSmoothness:  # noqa: ARG002, part of the protocol
        """Return the term itself; the standard deviations are those of the model of the fit."""
        return self


@kernel(FLOATS_1D(FLOATS_1D, FLOATS_1D, FLOATS_2D))
def _measure_change(weight: Array, std: Array, theta: Array) -> Array:
    """Return the value of each pair of neighbours, (N,), counted for the earlier frame."""
    out = np.zeros(len(theta))
    for t in range(len(weight)):
        for i in range(len(std)):
            change = (theta[t + 1, i] - theta[t, i]) / std[i]
            out[t] += weight[t] * change * change
    return out


@kernel(void(FLOATS_1D, FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_2D))
def _add_change(
    weight: Array, std: Array, theta: Array, diagonal: Array, coupling: Array, gradient: Array
) -> None:
    """Add the term to the diagonal blocks (N, n, n), to the coupling (1, N, n) and to the gradient (N, n)."""
    for t in range(len(weight)):
        for i in range(len(std)):
            stiffness = weight[t] / (std[i] * std[i])
            pull = stiffness * (theta[t + 1, i] - theta[t, i])
            diagonal[t, i, i] += stiffness
            diagonal[t + 1, i, i] += stiffness
            coupling[0, t, i] -= stiffness
            gradient[t, i] -= pull
            gradient[t + 1, i] += pull
