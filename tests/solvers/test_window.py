# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How solvers end and go on in pieces, Algorithm 1, and windows that cannot be solved."""

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint, periodic
from mocap_ros.solvers.alternation import reconstruct
from mocap_ros.solvers.levenberg_marquardt import Stepwise, ignore_overflow, run_to_end
from mocap_ros.solvers.window import Reconstruction, SolverStatus, Window, choose_initial_values
from tests.support.synthetic_walk import make_walk, mpjpe_mm

CONFIG = SolverConfig(components=8, adapt_noise=False)


@pytest.fixture
def window(walk_model: BasePoses) -> Window:
    """Noisy points of a walk, with fixed initial values and unit, so that all solutions have one objective."""
    window = make_walk(walk_model).window
    window = replace(window, points=window.points + 2 * np.random.default_rng(0).normal(size=window.points.shape))
    start, unit = choose_initial_values(window, walk_model.truncate(CONFIG.components), 1.0)
    return replace(window, start=start, unit=unit)


def solve_jointly(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    (result,) = joint.solve([window], model, config)
    return result


SOLVERS = [solve_jointly, reconstruct, periodic.solve]


@pytest.mark.parametrize('solve', SOLVERS)
def test_status_tells_convergence_from_the_limit_of_iterations(
    walk_model: BasePoses, window: Window, solve: Callable[[Window, BasePoses, SolverConfig], Reconstruction]
) -> None:
    converged = solve(window, walk_model, replace(CONFIG, max_iterations=500))
    assert converged.status is SolverStatus.CONVERGED
    assert converged.success
    assert 1 < converged.iterations < 500
    stopped = solve(window, walk_model, replace(CONFIG, max_iterations=converged.iterations - 1))
    assert stopped.status is SolverStatus.MAX_ITERATIONS
    assert not stopped.success
    assert stopped.iterations == converged.iterations - 1
    assert stopped.cost > converged.cost


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_numbers_that_overflow_are_no_success(walk_model: BasePoses, window: Window) -> None:
    (result,) = joint.solve([replace(window, points=1e200 * window.points)], walk_model, CONFIG)
    assert result.status is SolverStatus.SINGULAR
    assert not result.success


def test_recovers_a_synthetic_walk(walk_model: BasePoses) -> None:
    walk = make_walk(walk_model)
    config = SolverConfig(
        prior_weight=1e-7, bone_weight=0.05, flip_weight=1e-5, components=4,
        max_iterations=400, tolerance=1e-7,
    )  # fmt: skip
    result = reconstruct(walk.window, walk_model, config)
    assert mpjpe_mm(result.joints, walk.poses(walk_model)) < 1.1 * 1.67  # mm; measured: 1.667
    assert result.residual.max() < 1.1 * 0.25  # px; measured: 0.249
    assert result.translation == pytest.approx(np.tile([320, 240], (40, 1)), abs=1e-3)  # px


@settings(max_examples=15)
@example(seed=405, bone=0.0, prior=0.0, flip=0.0, missing=0.5)  # nothing determines the weights of a frame
@given(
    seed=st.integers(0, 1000),
    bone=st.floats(0, 100),
    prior=st.floats(0, 1e-2),
    flip=st.floats(0, 1),
    missing=st.floats(0, 0.5),
)
def test_objective_never_rises(
    walk_model: BasePoses, seed: int, bone: float, prior: float, flip: float, missing: float
) -> None:
    config = SolverConfig(bone_weight=bone, prior_weight=prior, flip_weight=flip, components=8, max_iterations=6)
    exact, rng = make_walk(walk_model, frames=12, seed=seed).window, np.random.default_rng(seed)
    points = exact.points + 5 * rng.normal(size=exact.points.shape)
    weight = rng.uniform(0.1, 1, points.shape[:2]) * (rng.random(points.shape[:2]) >= missing)
    for solve in (reconstruct, solve_jointly):
        result = solve(Window(points, weight, exact.times), walk_model, config)
        assert (np.diff(result.history) <= 1e-9 * np.abs(result.history[0])).all()
        assert np.isfinite(result.joints).all()


@pytest.mark.parametrize(('kept', 'seen', 'message'), [(39, 1, 'do not fit'), (40, 0, 'nothing to reconstruct')])
def test_unsolvable_windows_are_refused(walk_model: BasePoses, kept: int, seen: int, message: str) -> None:
    _, _, points, times = make_walk(walk_model)
    with pytest.raises(InputError, match=message):
        Window(points[:kept], np.full((40, 15), float(seen)), times)


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
