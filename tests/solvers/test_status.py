# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a result says about how its solver ended is what the solver did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import alternation, joint, periodic
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.reference import compute_cost
from mocap_ros.solvers.levenberg_marquardt import (
    DAMPING_AFTER_FAILURE,
    DAMPING_AFTER_SUCCESS,
    MAX_DAMPING,
    MIN_DAMPING,
)
from mocap_ros.solvers.window import (
    InitialValues,
    Reconstruction,
    SolverStatus,
    Window,
    choose_initial_values,
)
from tests.support.synthetic_walk import make_walk

CONFIG = SolverConfig(components=8, adapt_noise=False)


@pytest.fixture
def window(walk_model: BasePoses) -> Window:
    """Noisy points of a walk, with fixed initial values and unit, so that all solutions have one objective."""
    _, _, points, times = make_walk(walk_model)
    points = points + 2 * np.random.default_rng(0).normal(size=points.shape)
    window = Window(points, np.ones(points.shape[:2]), times)
    start, unit = choose_initial_values(window, walk_model.truncate(CONFIG.components), 1.0)
    return replace(window, start=start, unit=unit)


def solve_jointly(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    (result,) = joint.solve([window], model, config)
    return result


def solve_periodically(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    (result,) = periodic.solve([window], model, config)
    return result


SOLVERS = [solve_jointly, alternation.reconstruct, solve_periodically]


@pytest.mark.parametrize('solve', SOLVERS)
def test_status_tells_convergence_from_the_limit_of_iterations(
    walk_model: BasePoses, window: Window, solve: Callable[[Window, BasePoses, SolverConfig], Reconstruction]
) -> None:
    converged = solve(window, walk_model, replace(CONFIG, max_iterations=500))
    assert converged.status is SolverStatus.CONVERGED
    assert converged.success
    assert converged.message == 'Converged: the last iteration changed the objective by less than the tolerance.'
    assert 1 < converged.iterations < 500
    stopped = solve(window, walk_model, replace(CONFIG, max_iterations=converged.iterations - 1))
    assert stopped.status is SolverStatus.MAX_ITERATIONS
    assert not stopped.success
    assert stopped.message == 'Not converged: the largest number of iterations was reached.'
    assert stopped.iterations == converged.iterations - 1
    assert stopped.cost > converged.cost


@pytest.mark.parametrize('solve', [solve_jointly, solve_periodically])
def test_without_tolerance_the_solver_ends_where_no_step_helps(
    walk_model: BasePoses, window: Window, solve: Callable[[Window, BasePoses, SolverConfig], Reconstruction]
) -> None:
    result = solve(window, walk_model, replace(CONFIG, max_iterations=1000, tolerance=0.0))
    assert result.status is SolverStatus.NO_LOWER_STEP
    assert result.success
    assert result.iterations < 1000


def test_cost_is_that_of_the_solution(walk_model: BasePoses, window: Window) -> None:
    model = walk_model.truncate(CONFIG.components)
    result = solve_jointly(window, model, CONFIG)
    assert window.unit is not None
    unit = np.array([window.unit])
    batch = Batch.build([window], unit, model)
    state = batch.initial_state([InitialValues(result.theta, result.cameras)], unit)
    state = state._replace(translation=result.translation / window.unit)
    cost = compute_cost(JointObjective.build(batch, model, CONFIG), state)
    assert result.cost == pytest.approx(cost[0], rel=1e-9)
    assert result.cost == result.history[-1] < result.history[0]


def test_the_steps_of_all_rounds_of_noise_are_counted(walk_model: BasePoses, window: Window) -> None:
    config = replace(CONFIG, adapt_noise=True, max_iterations=3, tolerance=0.0)
    (cold,) = joint.solve([replace(window, start=None, unit=None)], walk_model, config)
    assert len(cold.history) == 4
    assert cold.iterations > 3
    (given,) = joint.solve([replace(window, noise=cold.noise)], walk_model, config)
    assert given.iterations == 3


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_numbers_that_overflow_are_no_success(walk_model: BasePoses, window: Window) -> None:
    (result,) = joint.solve([replace(window, points=1e200 * window.points)], walk_model, CONFIG)
    assert result.status is SolverStatus.SINGULAR
    assert result.message == 'Not converged: the equations for the next step have no finite solution.'
    assert not result.success


def test_the_damping_follows_the_rule(walk_model: BasePoses, window: Window) -> None:
    """The compiled solver's steps against the rule of Levenberg-Marquardt, up to the end of two sequences."""
    assert window.start is not None
    assert window.unit is not None
    model, windows, units = walk_model.truncate(CONFIG.components), [window] * 2, np.array([window.unit] * 2)
    batch = Batch.build(windows, units, model)
    state = batch.initial_state([window.start] * 2, units)
    problem = JointObjective.build(batch, model, CONFIG).compile(state)
    problem.begin(1e-2)
    outcomes = set()
    for _ in range(1000):
        damping, cost, done = problem.damping.copy(), problem.cost.copy(), problem.is_done.copy()
        taken, remaining = problem.try_steps(0.0)
        problem.update_equations()
        is_better = problem.cost < cost
        assert (problem.cost <= cost).all()
        assert taken == is_better.sum()
        assert remaining == (~problem.is_done).sum()
        ended = ~is_better & (damping > MAX_DAMPING)
        assert (problem.is_done == (done | ended)).all()
        factor = np.where(is_better, DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE)
        expected = np.where(problem.is_done, damping, np.maximum(damping * factor, MIN_DAMPING))
        np.testing.assert_allclose(problem.damping, expected, rtol=1e-12)
        outcomes |= {*is_better.tolist()}
        if not remaining:
            break
    assert outcomes == {True, False}
    assert problem.status.tolist() == [SolverStatus.NO_LOWER_STEP] * 2
