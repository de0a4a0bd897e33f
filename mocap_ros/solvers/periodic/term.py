# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What every term of the periodic objective offers beside those of the body (reprojection and bone lengths).

A new term is a file with a class of this form, and a line in `objective.PeriodicObjective.build`.
"""

from __future__ import annotations

from typing import Protocol

from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.point import Point


class Term(Protocol):
    """A term of the objective of one window."""

    def cost(self, point: Point) -> float:
        """Return the value of the term, m^2."""

    def add_to(self, equations: PeriodicEquations, point: Point) -> None:
        """Add the Gauss-Newton matrix and half the gradient of the term to the equations, in place."""
