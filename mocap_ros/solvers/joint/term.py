# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What every term of the joint objective offers.

A new term is a file with a class of this form, and a line in `objective.JointObjective.build`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]


class Term(Protocol):
    """A term of the objective, over all frames of a batch."""

    def cost(self, fit: Fit) -> Array:
        """Return the value (N,) m^2 of the term in each frame; a pair of frames counts for the earlier of them."""

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the Gauss-Newton matrix and half the gradient of the term to the equations, in place."""

    def subsampled(self, kept: Subsample) -> Term:
        """Return the term of some frames only."""

    def with_components(self, k: int) -> Term:
        """Return the term for the first `k` base poses only."""
