# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver, in the form in which Levenberg-Marquardt minimises it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mocap_ros.solvers import levenberg_marquardt
from mocap_ros.solvers.block_banded import DampedSolution
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]


Descent: TypeAlias = levenberg_marquardt.Descent[Fit, NormalEquations, DampedSolution]


@dataclass(frozen=True, eq=False)
class JointProblem:
    """The objective of a batch as a problem whose points are fits: `levenberg_marquardt.Problem`."""

    objective: JointObjective

    def cost(self, fit: Fit) -> Array:
        """Return the objective of each sequence, (P,) m^2."""
        return self.objective.cost(fit)

    def normal_equations(
        self, fit: Fit, previous: NormalEquations | None, is_done: NDArray[np.bool_]
    ) -> NormalEquations:
        """Return the equations at a fit; a sequence that is done keeps its previous ones.

        The factorisation of its matrix then stays that of the step with which it converged.
        """
        if previous is None or not is_done.any():
            return self.objective.normal_equations(fit)
        done_frames = self.objective.batch.repeat_per_frame(is_done)
        equations = self.objective.normal_equations(fit, self.objective.is_free & ~done_frames)
        return equations.with_frozen(done_frames, previous)

    def step(self, equations: NormalEquations, damping: Array) -> DampedSolution | None:
        """Return the negative of the step under these dampings; None if the matrix is not positive definite."""
        return self.objective.step(equations, damping)

    def advance(self, fit: Fit, step: DampedSolution) -> Fit:
        """Return the fit after a step, with the best translations."""
        return self.objective.with_optimal_translation(fit.state.advanced(-step.solution))

    def choose(self, is_chosen: NDArray[np.bool_], new: Fit, old: Fit) -> Fit:
        """Return the new fit in the sequences that are chosen, and the old one in the others."""
        frames = self.objective.batch.repeat_per_frame(is_chosen)
        return self.objective.fit(new.state.where(frames, old.state))
