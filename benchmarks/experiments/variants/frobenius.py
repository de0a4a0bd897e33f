# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Algorithm 1 with the terms as the paper prints them (TPAMI 2016, eq. 13 and 21).

Their norms are not squared, and the bone-length term is a variance, not a sum:

    (sum_tj w_tj |M_t P_tj + t_t - x_tj|^2 / s0^2)^(1/2)          eq. 9
  + beta   sum_b Var(length_b)                                    eq. 20
  + gamma  sum_t |M_t - M_(t-1)|_F / dt_t                         eq. 12

A norm lies below the parabola |x| <= x^2 / (2 |x'|) + |x'| / 2 that touches it at the current x'. Each step
therefore lowers the squared form of `mocap_ros.solvers.alternation` with every norm's weight divided by 2 |x'|
(iteratively reweighted least squares).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.alternation import AlternationProblem, WeightEquations, alternate
from mocap_ros.solvers.window import Reconstruction, Window, choose_initial_values

Array = NDArray[np.float64]

NORM_SMOOTHING = 1e-6  # m; makes sqrt(x^2 + NORM_SMOOTHING^2) differentiable at x = 0, far below any image noise


def reconstruct_with_printed_norms(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    """Reconstruct the sequence of one person as `alternation.reconstruct` does, but with the norms as printed."""
    model = model.truncate(config.components)
    start, s0 = choose_initial_values(window, model, config.start_window)
    squared = AlternationProblem.build(model, window, s0, config)
    problem = PrintedNorms(**{field.name: getattr(squared, field.name) for field in fields(squared)})
    return alternate(problem, start, s0, config)


@dataclass(frozen=True, eq=False)
class PrintedNorms(AlternationProblem):
    """The objective of one sequence with the norms as printed, and the steps that lower it."""

    def objective(self, cameras: WeakPerspectiveCameras, theta: Array) -> float:
        """Return the value of the objective at the head of this module."""
        data, change = self._norms(cameras, theta)
        length, _ = self.bone_lengths(theta)
        flip = (np.sqrt(self.flip) * change).sum()
        prior = (self.prior * theta**2).sum()
        return float(data + flip + self.beta * length.var(axis=0).sum() + prior)

    def optimise_cameras(self, cameras: WeakPerspectiveCameras, theta: Array) -> WeakPerspectiveCameras:
        return self._reweighted(cameras, theta).optimise_cameras(cameras, theta)

    def weight_equations(self, cameras: WeakPerspectiveCameras, theta: Array) -> WeightEquations:
        return self._reweighted(cameras, theta).weight_equations(cameras, theta)

    def _norms(self, cameras: WeakPerspectiveCameras, theta: Array) -> tuple[Array, Array]:
        """Return the norm of all reprojection errors, and (gamma / dt)^(1/2) |M_t - M_(t-1)|_F (F - 1,)."""
        squared = self.camera_objective(theta)
        return (
            np.sqrt(squared.data_cost(cameras).sum() + NORM_SMOOTHING**2),
            np.sqrt(squared.flip_cost(cameras) + NORM_SMOOTHING**2),
        )

    def _reweighted(self, cameras: WeakPerspectiveCameras, theta: Array) -> AlternationProblem:
        """Return the squared form that touches this objective at the given cameras and weights."""
        data, change = self._norms(cameras, theta)
        weights: dict[str, Any] = {
            'weight': self.weight / (2 * data),
            'flip': self.flip * np.sqrt(self.flip) / (2 * change),
            'beta': self.beta / len(theta),
        }
        return AlternationProblem(**{f.name: weights.get(f.name, getattr(self, f.name)) for f in fields(self)})
