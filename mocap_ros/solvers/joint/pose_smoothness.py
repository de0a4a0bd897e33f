"""The smoothness of the base-pose weights over time (beyond TPAMI 2016).

    mu sum_tl ((theta_tl - theta_(t-1)l) / sigma_l)^2 / dt_t

with sigma_l the standard deviation of weight l over the training poses, and dt_t the time between the two frames,
so that the term does not depend on the frame rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
        theta = fit.state.theta
        cost = np.zeros(len(theta))
        cost[:-1] = self.weight * ((theta[1:] - theta[:-1]) ** 2 @ fit.model.std**-2)
        return cost

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling of neighbours and the gradient, in place."""
        theta = fit.state.theta
        k = theta.shape[1]
        precision = 1 / fit.model.std**2
        stiffness = np.zeros(len(theta))
        stiffness[:-1] += self.weight
        stiffness[1:] += self.weight
        np.einsum('nii->ni', equations.diagonal)[:, :k] += stiffness[:, None] * precision
        equations.coupling.diagonal[:, :k] -= self.weight[:, None] * precision
        pull = self.weight[:, None] * (theta[1:] - theta[:-1]) * precision
        equations.gradient[1:, :k] += pull
        equations.gradient[:-1, :k] -= pull

    def subsampled(self, kept: Subsample) -> PoseSmoothness:
        """Return the term of some frames only."""
        return replace(self, weight=self.weight[kept.pairs] * kept.pair_factor)

    def with_components(self, k: int) -> PoseSmoothness:  # noqa: ARG002, part of the protocol
        """Return the term itself; the standard deviations are those of the model of the fit."""
        return self
