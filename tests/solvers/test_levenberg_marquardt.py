# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Levenberg-Marquardt on curves a exp(b t): the right minimum, batches that equal their parts, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares

from mocap_ros.solvers.levenberg_marquardt import (
    DAMPING_AFTER_FAILURE,
    DAMPING_AFTER_SUCCESS,
    MAX_DAMPING,
    MIN_DAMPING,
    Descent,
    judge_steps,
    minimise,
)
from mocap_ros.solvers.window import SolverStatus

TIMES = np.linspace(0, 1, 12)
FIRST_DAMPING = 1e-2


@dataclass(frozen=True)
class Equations:
    """Gauss-Newton matrices (P, 2, 2) and half gradients (P, 2)."""

    matrix: np.ndarray
    gradient: np.ndarray


@dataclass
class Curves:
    """The squared distances of P curves from their values (P, T); a point is (P, 2)."""

    values: np.ndarray
    singular_above: float = np.inf

    def residuals(self, point: np.ndarray) -> np.ndarray:
        return point[:, :1] * np.exp(point[:, 1:] * TIMES) - self.values

    def cost(self, point: np.ndarray) -> np.ndarray:
        return np.asarray((self.residuals(point) ** 2).sum(axis=1))

    def normal_equations(self, point: np.ndarray, previous: Equations | None, is_done: np.ndarray) -> Equations:
        exponential = np.exp(point[:, 1:] * TIMES)
        jacobian = np.stack([exponential, point[:, :1] * TIMES * exponential], axis=-1)
        matrix = np.swapaxes(jacobian, 1, 2) @ jacobian
        gradient = (np.swapaxes(jacobian, 1, 2) @ self.residuals(point)[..., None])[..., 0]
        if previous is not None:
            matrix[is_done], gradient[is_done] = previous.matrix[is_done], previous.gradient[is_done]
        return Equations(matrix, gradient)

    def step(self, equations: Equations, damping: np.ndarray) -> np.ndarray | None:
        if damping.max() > self.singular_above:
            return None
        damped = equations.matrix * (1 + damping[:, None, None] * np.eye(2))
        return -np.linalg.solve(damped, equations.gradient[..., None])[..., 0]

    def advance(self, point: np.ndarray, step: np.ndarray) -> np.ndarray:
        return point + step

    def choose(self, is_chosen: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
        return np.where(is_chosen[:, None], new, old)


START = np.array([[1.0, 0.0], [1.0, 4.0], [-3.0, 1.0]])


@pytest.fixture
def curves(rng: np.random.Generator) -> Curves:
    """One curve that starts near its minimum and two that start far away."""
    true = np.array([[1.1, 0.1], [2.0, -3.0], [3.0, 2.0]])
    return Curves(true[:, :1] * np.exp(true[:, 1:] * TIMES) + 0.02 * rng.normal(size=(3, len(TIMES))))


def run(
    problem: Curves, start: np.ndarray, max_iterations: int = 100, tolerance: float = 1e-12
) -> Descent[np.ndarray, Equations, np.ndarray]:
    return minimise(problem, start, max_iterations, tolerance, FIRST_DAMPING)


def test_minimum_is_that_of_scipy_and_the_objective_never_rises(curves: Curves) -> None:
    descent = run(curves, START)
    assert descent.status.tolist() == [SolverStatus.CONVERGED] * 3
    history = np.array(descent.history)
    assert (np.diff(history, axis=0) <= 0).all()
    assert history[0] == pytest.approx(curves.cost(START))
    assert history[-1] == pytest.approx(curves.cost(descent.point))
    for i, start in enumerate(START):
        one = Curves(curves.values[i : i + 1])
        exact = least_squares(lambda x, one=one: one.residuals(x[None])[0], start, xtol=1e-15, ftol=1e-15)
        assert descent.point[i] == pytest.approx(exact.x, rel=1e-6)


def test_a_batch_equals_its_parts(curves: Curves) -> None:
    together = run(curves, START)
    assert len(set(together.iterations.tolist())) == 3
    assert len(together.history) == together.iterations.max() + 1
    for i in range(3):
        alone = run(Curves(curves.values[i : i + 1]), START[i : i + 1])
        assert together.point[i] == pytest.approx(alone.point[0], rel=1e-12)
        assert together.equations.matrix[i] == pytest.approx(alone.equations.matrix[0], rel=1e-12)
        assert together.damping[i] == alone.damping[0]
        assert together.iterations[i] == alone.iterations[0]
        assert together.status[i] == alone.status[0]


def test_the_limit_of_iterations_is_a_limit(curves: Curves) -> None:
    descent = run(curves, START, max_iterations=2)
    assert descent.status.tolist() == [SolverStatus.MAX_ITERATIONS] * 3
    assert descent.iterations.tolist() == [2, 2, 2]
    assert len(descent.history) == 3


def test_without_tolerance_it_ends_where_no_step_helps(curves: Curves) -> None:
    descent = run(curves, START, max_iterations=1000, tolerance=0.0)
    assert descent.status.tolist() == [SolverStatus.NO_LOWER_STEP] * 3
    assert (descent.damping > MAX_DAMPING).all()
    assert np.abs(descent.equations.gradient).max() < 1e-7


def test_equations_without_solution_are_tried_under_more_damping(curves: Curves) -> None:
    curves.singular_above = 0.0
    descent = run(curves, START)
    assert descent.status.tolist() == [SolverStatus.SINGULAR] * 3
    assert descent.step is None
    assert (descent.point == START).all()
    assert descent.iterations.tolist() == [12] * 3  # 1e-2 times 10, up to more than 1e8


def test_an_objective_that_is_not_finite_is_no_success(curves: Curves) -> None:
    curves.values[1, 0] = np.nan
    descent = run(curves, START)
    assert descent.status.tolist() == [SolverStatus.CONVERGED, SolverStatus.SINGULAR, SolverStatus.CONVERGED]


@pytest.mark.parametrize('is_singular', [False, True])
def test_steps_are_judged_by_the_rules(rng: np.random.Generator, is_singular: bool) -> None:
    """The kernel against the same rules for arrays."""
    n, tolerance = 200, 0.05
    cost = np.asarray(10.0 ** rng.integers(-3, 4, n), np.float64)
    trial = cost * rng.choice([0.5, 0.99, 1.0, 1.5, np.nan], n)
    cost[:5] = np.inf
    damping = np.asarray(10.0 ** rng.integers(-6, 11, n), np.float64)
    iterations, status = rng.integers(0, 9, n), rng.integers(-1, 3, n)
    is_done = rng.random(n) < 0.3

    better = ~is_done & (trial < cost) & (not is_singular)
    new_cost = np.where(better, trial, cost)
    with np.errstate(invalid='ignore'):
        settled = better & (cost - new_cost <= tolerance * new_cost)
    stuck = damping > MAX_DAMPING
    failed = ~np.isfinite(new_cost) | is_singular
    stuck_status = np.where(failed, SolverStatus.SINGULAR, SolverStatus.NO_LOWER_STEP)
    going_on = SolverStatus.SINGULAR if is_singular else SolverStatus.MAX_ITERATIONS
    end = np.where(settled, SolverStatus.CONVERGED, np.where(stuck, stuck_status, going_on))
    expected_status = np.where(is_done, status, end)
    now_done = is_done | settled | stuck
    factor = np.where(better, DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE)
    expected_damping = np.where(now_done, damping, np.maximum(damping * factor, MIN_DAMPING))
    expected_iterations = iterations + ~is_done

    is_better = np.zeros(n, bool)
    taken, remaining = judge_steps(
        trial, is_singular, tolerance, cost, damping, iterations, status, is_done, is_better
    )
    assert (is_better == better).all()
    assert (cost == new_cost).all()
    assert (is_done == now_done).all()
    assert (status == expected_status).all()
    assert damping == pytest.approx(expected_damping, rel=1e-15)
    assert (iterations == expected_iterations).all()
    assert taken == better.sum()
    assert remaining == (~now_done).sum()
    assert is_singular or {*status.tolist()} == {*map(int, SolverStatus)}
