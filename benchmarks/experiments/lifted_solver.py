"""The joint solver with the lifter's term in its objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from mocap_ros import nonperiodic
from mocap_ros.base_poses import BasePoses
from mocap_ros.config import SolverConfig
from mocap_ros.learned_prior import LIFTED_WEIGHT, PCA_SHARE, SMOOTH_SHARE, LiftedTerm, lifted_start
from mocap_ros.lifter import Lifted
from mocap_ros.objective import NormalEquations, Problem, State, initial_state
from mocap_ros.reconstruction import Reconstruction, Window, begin

Array = nonperiodic.Array


@dataclass(frozen=True, eq=False)
class LiftedProblem(Problem):
    """The problem of the joint solver with one term more."""

    lifted: LiftedTerm

    @staticmethod
    def of(problem: Problem, lifted: LiftedTerm) -> LiftedProblem:
        return LiftedProblem(**{f.name: getattr(problem, f.name) for f in fields(Problem)}, lifted=lifted)

    def thinned(self, step: float) -> tuple[Problem, np.ndarray]:
        few, kept = super().thinned(step)
        return replace(few, lifted=self.lifted.take(kept)), kept

    def _turned(self, state: State) -> tuple[Array, Array]:
        scaled = np.exp(state.log_scale)[:, None, None] * state.rotation
        return self.model.poses(state.theta) @ np.swapaxes(scaled, -1, -2), scaled

    def _cost(self, state: State, error: Array) -> Array:
        return super()._cost(state, error) + self.per_sequence(self.lifted.cost(self._turned(state)[0]))

    def normal_equations(self, state: State) -> NormalEquations:
        equations = super().normal_equations(state)
        basis = np.moveaxis(self.model.components, 0, -1)
        residual, jac = self.lifted.rows(*self._turned(state), basis)
        transposed = np.swapaxes(jac, -1, -2)
        equations.diagonal[:] += transposed @ jac
        equations.gradient[:] += (transposed @ residual[..., None])[..., 0]
        return equations


def solve(
    windows: Sequence[Window],
    lifted: Sequence[Lifted],
    model: BasePoses,
    config: SolverConfig,
    weight: float = LIFTED_WEIGHT,
) -> tuple[Reconstruction, ...]:
    """As `nonperiodic.solve`, begun at the lifted poses and held near them."""
    model = model.truncated(config.components)
    config = replace(
        config,
        prior_weight=PCA_SHARE * config.prior_weight,
        smooth_weight=SMOOTH_SHARE * config.smooth_weight,
    )
    windows = [replace(w, start=lifted_start(x, w, model)) for w, x in zip(windows, lifted, strict=True)]
    begun = [begin(w, model, config.start_window) for w in windows]
    starts = [start for start, _ in begun]
    units = np.array([unit for _, unit in begun])
    terms = [LiftedTerm.of(x, unit, weight) for x, unit in zip(lifted, units, strict=True)]
    problem = Problem.build(windows, units, model, config)
    problem = LiftedProblem.of(problem, LiftedTerm.joined(terms))
    state = problem.best_translation(initial_state(problem, starts, units))
    state = problem.best_translation(state)
    if config.adapt_noise:
        problem, state = nonperiodic._anneal(problem, state, windows, config)
    descent = nonperiodic._levenberg_marquardt(problem, state, config, nonperiodic.NEXT_DAMPING)
    return nonperiodic.results(problem, windows, units, descent)
