# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The Gaussian prior of the base-pose weights (beyond TPAMI 2016; the prior of the principal component analysis).

    lambda sum_tl (theta_tl / sigma_l)^2

with sigma_l the standard deviation of weight l over the training poses.
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
class BasePosePrior:
    """The Gaussian prior of the base-pose weights in all frames of a batch, as a term of the joint objective.

    Attributes:
        precision: (K,) lambda / sigma_l^2, the factor on the square of each base-pose weight; it has no unit, as
            lambda is in m^2 and sigma_l in m.
    """

    precision: Array

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of the term in each frame."""
        return np.asarray(fit.state.theta**2 @ self.precision)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix and the gradient, in place."""
        _add_prior(self.precision, fit.state.theta, equations.diagonal, equations.gradient)

    def subsampled(self, kept: Subsample) -> BasePosePrior:  # noqa: ARG002, part of the protocol
        """Return the term itself, which is the same in every frame."""
        return self

    def with_components(self, k: int) -> BasePosePrior:
        """Return the prior of the first `k` weights."""
        return replace(self, precision=self.precision[:k])


@kernel(void(FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_2D))
def _add_prior(precision: Array, theta: Array, diagonal: Array, gradient: Array) -> None:
    """Add the prior of weights (N, K) to the diagonal blocks (N, n, n) and the gradient (N, n), in place."""
    for t in range(len(theta)):
        for i in range(len(precision)):
            diagonal[t, i, i] += precision[i]
            gradient[t, i] += precision[i] * theta[t, i]
