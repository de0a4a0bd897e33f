# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The Gaussian prior of the coefficients of the series (beyond TPAMI 2016).

    lambda sum_pl c_pl^2 / var_pl

It occurs once a window, not once a frame, since the coefficients do. The variance of a weight over time and
persons is shared among the terms of its series (`fourier.variance_shares`); the constants have less, for a
person's mean pose is near that of the model, and the camera already contains the mean heading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.solvers.periodic.fourier import variance_shares
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.point import Point

Array = NDArray[np.float64]

CONSTANT_STD = 0.008  # m; of the constant coefficients: a person's mean pose is near that of the model
HEADING_STD = 0.25  # rad; of the heading: the body turns by 7 degrees RMS in CMU walks, by 15 in runs
CONSTANT_HEADING_STD = 1e-3  # rad; of the constant of the heading: the rotation of the camera already contains it


@dataclass(frozen=True, eq=False)
class CoefficientPrior:
    """The prior as a term of the periodic objective.

    Attributes:
        precision: (P, K + 1) lambda / var_pl, the factor on the square of each coefficient.
    """

    precision: Array

    @staticmethod
    def build(harmonics: int, std: Array, weight: float) -> CoefficientPrior:
        """Return the prior.

        Args:
            harmonics: of the series.
            std: (K,) m, standard deviation of each base-pose weight over the training poses.
            weight: lambda, m^2.
        """
        variance = variance_shares(harmonics)[:, None] * np.append(std, HEADING_STD) ** 2
        variance[0] = 1 / (1 / variance[0] + 1 / CONSTANT_STD**2)
        variance[0, -1] = CONSTANT_HEADING_STD**2
        return CoefficientPrior(weight / variance)

    def cost(self, point: Point) -> float:
        """Return the value of the term, m^2."""
        return float((self.precision * point.series.coefficients**2).sum())

    def add_to(self, equations: PeriodicEquations, point: Point) -> None:
        """Add the matrix, which is diagonal, and the gradient, in place."""
        size = self.precision.size
        equations.series_prior[:size] += self.precision.ravel()
        equations.series_gradient[:size] += (self.precision * point.series.coefficients).ravel()
