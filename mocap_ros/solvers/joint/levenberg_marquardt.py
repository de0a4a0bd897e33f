"""Levenberg-Marquardt over a batch: every sequence has its own damping and its own end, and all step together.

A step x solves (A + mu diag(A)) x = -g with A the Gauss-Newton matrix, g half the gradient and mu the damping. It
is taken where it lowers the objective of its sequence, whose damping is then divided by five; elsewhere the
damping is multiplied by ten and the step is tried again. So the objective never rises.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.solvers.block_banded import BlockCholesky
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.state import Fit, State
from mocap_ros.solvers.stepwise import Stepwise, run_to_end
from mocap_ros.solvers.window import SolverStatus

Array = NDArray[np.float64]

MIN_DAMPING = 1e-5  # relative; a smaller damping changes no digit of a step that matters
MAX_DAMPING = 1e8  # relative; a sequence whose steps are still refused under more damping is at its minimum
DAMPING_AFTER_SUCCESS = 0.2  # factor; tuned on CMU views for few steps, as the next
DAMPING_AFTER_FAILURE = 10.0  # factor


@dataclass(frozen=True, eq=False)
class Descent:
    """Where Levenberg-Marquardt ended.

    Attributes:
        fit: of the last state.
        equations: normal equations of the last state, or of the one before.
        banded: their factorised matrix; None where no step could be computed.
        objective: (P,) m^2 of the initial state and after each step that was tried.
        iterations: (P,) number of steps of each sequence that were tried.
        status: (P,) `SolverStatus` of each sequence.
    """

    fit: Fit
    equations: NormalEquations
    banded: BlockCholesky | None
    objective: list[Array]
    iterations: NDArray[np.intp]
    status: NDArray[np.intp]


def minimise(objective: JointObjective, state: State, config: SolverConfig, first_damping: float) -> Descent:
    """Minimise the objective as `minimise_stepwise` does, at once."""
    return run_to_end(minimise_stepwise(objective, state, config, first_damping))


def minimise_stepwise(
    objective: JointObjective, state: State, config: SolverConfig, first_damping: float
) -> Stepwise[Descent]:
    """Minimise the objective from a state on.

    Args:
        objective: of the batch.
        state: initial values of the unknowns.
        config: `max_iterations` and `tolerance` apply.
        first_damping: damping of the first step.
    """
    sequences = len(objective.batch.starts)
    fit = objective.fit(state)
    cost = objective.cost(fit)
    history = [cost]
    damping = np.full(sequences, first_damping)
    is_done = np.zeros(sequences, bool)
    status = np.full(sequences, SolverStatus.MAX_ITERATIONS, dtype=np.intp)
    iterations = np.zeros(sequences, int)
    equations = objective.normal_equations(fit)
    are_equations_outdated = False
    banded = None
    for _ in range(config.max_iterations):
        yield
        if are_equations_outdated:
            done_frames = objective.batch.repeat_per_frame(is_done)
            equations = objective.normal_equations(fit).with_frozen(done_frames, equations)
            are_equations_outdated = False
        solved = objective.step(equations, damping)
        iterations += ~is_done
        if solved is None:
            history.append(cost)
            damping = np.where(is_done, damping, damping * DAMPING_AFTER_FAILURE)
            status[~is_done] = SolverStatus.SINGULAR
            continue
        step, banded = solved
        trial = objective.with_optimal_translation(fit.state.advanced(step))
        trial_cost = objective.cost(trial)
        is_better = ~is_done & (trial_cost < cost)
        gain = np.where(is_better, cost - trial_cost, 0.0)
        if is_better.all():
            fit = trial
        elif is_better.any():
            chosen = objective.batch.repeat_per_frame(is_better)
            fit = objective.fit(trial.state.where(chosen, fit.state))
        cost = np.where(is_better, trial_cost, cost)
        history.append(cost)
        has_settled, is_stuck = is_better & (gain <= config.tolerance * cost), damping > MAX_DAMPING
        stuck_status = np.where(np.isfinite(cost), SolverStatus.NO_LOWER_STEP, SolverStatus.SINGULAR)
        end = np.where(is_stuck, stuck_status, SolverStatus.MAX_ITERATIONS)
        status = np.where(is_done, status, np.where(has_settled, SolverStatus.CONVERGED, end))
        is_done |= has_settled | is_stuck
        factor = np.where(is_better, DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE)
        damping = np.where(is_done, damping, np.maximum(damping * factor, MIN_DAMPING))
        if is_done.all():
            break
        are_equations_outdated = bool(is_better.any())
    return Descent(fit, equations, banded, history, iterations, status)
