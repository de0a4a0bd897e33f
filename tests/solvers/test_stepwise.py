# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Stepwise solvers: a piece of work has at most one step of Levenberg-Marquardt, and errors pass through."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import classification, joint, periodic
from mocap_ros.solvers.levenberg_marquardt import Problem, minimise_stepwise
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.stepwise import Stepwise, ignore_overflow, run_to_end
from tests.support.synthetic_walk import make_noisy_window

CONFIG = SolverConfig(components=8, max_iterations=6, heading_hypotheses=2)


def overflow_twice() -> Stepwise[float]:
    large = np.array([1e308])
    first = large * 10
    yield
    return float((first * large)[0])


def test_results_errors_and_overflows_are_those_of_the_work() -> None:
    def fail() -> Stepwise[int]:
        yield
        raise ValueError('in the second piece')

    assert run_to_end(ignore_overflow(overflow_twice())) == np.inf
    for work in (fail(), ignore_overflow(fail())):
        next(work)
        with pytest.raises(ValueError, match='in the second piece'):
            next(work)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        next(ignore_overflow(overflow_twice()))
        with pytest.raises(RuntimeWarning, match='overflow'):  # between the pieces
            np.array([1e308]) * 10


class CountedProblem:
    """A problem whose steps are counted in a list."""

    def __init__(self, problem: Problem, steps: list[int]) -> None:
        self.problem, self.steps = problem, steps

    def __getattr__(self, name: str) -> Any:
        if name == 'try_steps':
            self.steps.append(1)
        return getattr(self.problem, name)


def test_each_piece_has_one_step_at_most(walk_model: BasePoses, monkeypatch: pytest.MonkeyPatch) -> None:
    window = make_noisy_window(walk_model, seed=0, missing=0.1)
    steps: list[int] = []

    solve_step = PeriodicEquations.solve_step

    def count_and_solve(equations: PeriodicEquations, damping: float) -> object:
        steps.append(1)
        return solve_step(equations, damping)

    def count_and_try(
        problem: Problem, max_iterations: int, tolerance: float, damping: float
    ) -> Stepwise[np.ndarray]:
        return minimise_stepwise(CountedProblem(problem, steps), max_iterations, tolerance, damping)

    monkeypatch.setattr(PeriodicEquations, 'solve_step', count_and_solve)
    monkeypatch.setattr(joint.noise_annealing, 'minimise_stepwise', count_and_try)
    all_work: list[Stepwise[object]] = [
        joint.solve_stepwise([window], walk_model, CONFIG),
        joint.solve_hypotheses_stepwise([window], walk_model, CONFIG),
        periodic.solve_stepwise([window], walk_model, CONFIG),
        classification.minus_twice_log_evidence_stepwise(window, walk_model, 0.01, CONFIG),
        classification.fit_periodic_stepwise(window, {'walk': walk_model}, CONFIG),
    ]
    for work in all_work:
        steps.clear()
        largest = 0
        for _ in work:
            largest, total = max(largest, len(steps)), len(steps)
            steps.clear()
        assert largest == 1
        assert total <= 1
        assert not steps
