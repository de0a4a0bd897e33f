# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Levenberg-Marquardt over a batch: every sequence has its own damping and its own end, and all step together.

A step x solves (A + mu diag(A)) x = -g with A the Gauss-Newton matrix, g half the gradient and mu the damping. It
is taken where it lowers the objective of its sequence, whose damping is then divided by five; elsewhere the
damping is multiplied by ten and the step is tried again. So the objective never rises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import BOOL, BOOLS_1D, FLOAT, FLOATS_1D, INT, INTS_1D, kernel
from mocap_ros.solvers.stepwise import Stepwise, run_to_end
from mocap_ros.solvers.window import SolverStatus

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Point = TypeVar('Point')
Equations = TypeVar('Equations')
Step = TypeVar('Step')

MIN_DAMPING = 1e-5  # relative; a smaller damping changes no digit of a step that matters
MAX_DAMPING = 1e8  # relative; a sequence whose steps are still refused under more damping is at its minimum
DAMPING_AFTER_SUCCESS = 0.2  # factor; tuned on CMU views for few steps, as the next
DAMPING_AFTER_FAILURE = 10.0  # factor

_SINGULAR, _MAX_ITERATIONS = int(SolverStatus.SINGULAR), int(SolverStatus.MAX_ITERATIONS)  # as kernels know them
_CONVERGED, _NO_LOWER_STEP = int(SolverStatus.CONVERGED), int(SolverStatus.NO_LOWER_STEP)


class Problem(Protocol[Point, Equations, Step]):
    """What is minimised: one objective for each of P sequences, which have no unknowns in common."""

    def cost(self, point: Point, /) -> Array:
        """Return the objectives (P,) at a point."""

    def normal_equations(self, point: Point, previous: Equations | None, is_done: Bools, /) -> Equations:
        """Return the equations of a Gauss-Newton step at a point.

        Args:
            point: values of the unknowns.
            previous: the equations before these; None if there are none yet.
            is_done: (P,) sequences that step no more; they keep their previous equations.
        """

    def step(self, equations: Equations, damping: Array, /) -> Step | None:
        """Return the step under these dampings (P,); None if the damped matrix is not positive definite."""

    def advance(self, point: Point, step: Step, /) -> Point:
        """Return the point after a step."""

    def choose(self, is_chosen: Bools, new: Point, old: Point, /) -> Point:
        """Return the new point in the sequences that are chosen (P,), and the old one in the others."""


@dataclass(frozen=True, eq=False)
class Descent(Generic[Point, Equations, Step]):
    """Where Levenberg-Marquardt ended.

    Attributes:
        point: the last point.
        equations: normal equations at the last point, or at the one before.
        step: the latest step that could be computed from these; None if none could.
        history: objectives (P,) at the initial point and after each step that was tried.
        iterations: (P,) number of steps of each sequence that were tried.
        status: (P,) `SolverStatus` of each sequence.
        damping: (P,) damping with which each sequence would go on.
    """

    point: Point
    equations: Equations
    step: Step | None
    history: list[Array]
    iterations: Ints
    status: Ints
    damping: Array


def minimise(
    problem: Problem[Point, Equations, Step],
    point: Point,
    max_iterations: int,
    tolerance: float,
    first_damping: float,
) -> Descent[Point, Equations, Step]:
    """Minimise the objectives from a point on.

    Args:
        problem: the objectives.
        point: initial values of the unknowns.
        max_iterations: largest number of steps that are tried.
        tolerance: a step that lowers an objective by no more than this share of it is the last of its sequence.
        first_damping: damping of the first step.
    """
    return run_to_end(minimise_stepwise(problem, point, max_iterations, tolerance, first_damping))


def minimise_stepwise(
    problem: Problem[Point, Equations, Step],
    point: Point,
    max_iterations: int,
    tolerance: float,
    first_damping: float,
) -> Stepwise[Descent[Point, Equations, Step]]:
    """Minimise as `minimise` does, in pieces: a step is one, and the normal equations at its end are the next."""
    cost = problem.cost(point).copy()
    sequences = len(cost)
    history = [cost.copy()]
    damping = np.full(sequences, float(first_damping))
    status = np.full(sequences, _MAX_ITERATIONS)
    iterations = np.zeros(sequences, np.int64)
    is_done, is_better = np.zeros(sequences, np.bool_), np.zeros(sequences, np.bool_)
    equations = problem.normal_equations(point, None, is_done)
    latest: Step | None = None
    is_outdated = False
    for _ in range(max_iterations):
        yield
        if is_outdated:
            equations = problem.normal_equations(point, equations, is_done)
            yield
        step = problem.step(equations, damping)
        trial, trial_cost = point, cost
        if step is not None:
            latest = step
            trial = problem.advance(point, step)
            trial_cost = problem.cost(trial)
        taken, remaining = judge_steps(
            trial_cost, step is None, tolerance, cost, damping, iterations, status, is_done, is_better
        )
        history.append(cost.copy())
        if taken == sequences:
            point = trial
        elif taken:
            point = problem.choose(is_better, trial, point)
        if not remaining:
            break
        is_outdated = taken > 0
    return Descent(point, equations, latest, history, iterations, status, damping)


@kernel(types.UniTuple(INT, 2)(FLOATS_1D, BOOL, FLOAT, FLOATS_1D, FLOATS_1D, INTS_1D, INTS_1D, BOOLS_1D, BOOLS_1D))
def judge_steps(
    trial_cost: Array,
    is_singular: bool,
    tolerance: float,
    cost: Array,
    damping: Array,
    iterations: Ints,
    status: Ints,
    is_done: Bools,
    is_better: Bools,
) -> tuple[int, int]:
    """Decide for each sequence whether its step is taken, whether it was the last, and the next damping.

    Args:
        trial_cost: (P,) objectives after the step.
        is_singular: whether no step could be computed.
        tolerance: relative decrease of the objective at which a sequence has converged.
        cost: (P,) objectives before the step, in place after it.
        damping: (P,) in place.
        iterations: (P,) steps that were tried, in place.
        status: (P,) `SolverStatus`, in place.
        is_done: (P,) in place.
        is_better: (P,) overwritten by whether the step of a sequence is taken.

    Returns:
        Number of sequences whose step is taken, and of those that are not done.
    """
    taken = remaining = 0
    for i in range(len(cost)):
        is_better[i] = not is_done[i] and not is_singular and trial_cost[i] < cost[i]
        if is_done[i]:
            continue
        iterations[i] += 1
        gain = 0.0
        if is_better[i]:
            gain = cost[i] - trial_cost[i]
            cost[i] = trial_cost[i]
            taken += 1
        if is_better[i] and gain <= tolerance * cost[i]:
            status[i] = _CONVERGED
            is_done[i] = True
        elif damping[i] > MAX_DAMPING:
            status[i] = _NO_LOWER_STEP if np.isfinite(cost[i]) and not is_singular else _SINGULAR
            is_done[i] = True
        else:
            status[i] = _SINGULAR if is_singular else _MAX_ITERATIONS
            factor = DAMPING_AFTER_SUCCESS if is_better[i] else DAMPING_AFTER_FAILURE
            damping[i] = max(damping[i] * factor, MIN_DAMPING)
            remaining += 1
    return taken, remaining
