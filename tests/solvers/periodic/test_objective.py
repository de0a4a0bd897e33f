# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The terms of the periodic objective beside those of the body: their gradients, matrices and weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.batch import State
from mocap_ros.solvers.periodic.fourier import FourierSeries
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.objective import (
    CONSTANT_HEADING_STD,
    PeriodicObjective,
    Point,
    measure_matrices,
    move_cameras,
)
from mocap_ros.solvers.window import Window
from tests.support.synthetic_walk import make_walk

COMPONENTS, HARMONICS, FRAMES = 4, 2, 7
CONFIG = SolverConfig(
    harmonics=HARMONICS, periodic_prior_factor=3.0, camera_velocity_weight=0.02, camera_acceleration_weight=0.001
)
SERIES_UNKNOWNS = (2 * HARMONICS + 1) * (COMPONENTS + 1) + 1
STEP = 1e-5  # of the finite differences: errors of rounding and of the third order are about equal


@pytest.fixture
def objective_and_point(walk_model: BasePoses, rng: np.random.Generator) -> tuple[PeriodicObjective, Point]:
    """A window at irregular times of which nothing is seen but in one frame, and tilted cameras that move."""
    model = walk_model.truncate(COMPONENTS)
    _, _, points, _ = make_walk(walk_model, frames=FRAMES)
    times, weight = np.cumsum(rng.uniform(0.02, 0.05, FRAMES)), np.zeros(points.shape[:2])
    weight[0] = 1e-300
    config = replace(CONFIG, bone_weight=0.0)
    objective = PeriodicObjective.build(Window(points, weight, times), 200.0, model, config)
    shape = (2 * HARMONICS + 1, COMPONENTS + 1)
    series = FourierSeries(0.05 * rng.normal(size=shape), 2 * np.pi * 0.9, float(times.mean()))
    cameras = State(
        np.zeros((FRAMES, 0)),
        rotation_from_vector(rng.normal(size=(FRAMES, 3))),
        0.1 * rng.normal(size=FRAMES),
        rng.normal(size=(FRAMES, 2)),
    )
    return objective, objective.measure(series, cameras)


def move(objective: PeriodicObjective, point: Point, step: np.ndarray) -> Point:
    """Return the point after a step of series and cameras in one vector."""
    cameras = move_cameras(point.cameras, step[SERIES_UNKNOWNS:].reshape(FRAMES, 4))
    return objective.measure(point.series.with_step(step[:SERIES_UNKNOWNS]), cameras)


def differentiate(
    objective: PeriodicObjective, point: Point, function: Callable[[Point], np.ndarray | float]
) -> np.ndarray:
    """Return central differences of a function of the point by all unknowns, one in each row."""
    rows = []
    for step in STEP * np.eye(SERIES_UNKNOWNS + FRAMES * 4):
        up, down = (np.asarray(function(move(objective, point, s))) for s in (step, -step))
        rows.append((up - down).ravel() / (2 * STEP))
    return np.array(rows)


def test_a_point_stays_when_another_one_is_measured(
    objective_and_point: tuple[PeriodicObjective, Point], rng: np.random.Generator
) -> None:
    objective, point = objective_and_point
    before = [np.copy(values) for values in (*point.cameras, *point.body)]
    objective.measure(point.series, point.cameras._replace(translation=rng.normal(size=(FRAMES, 2))))
    assert all(map(np.array_equal, (*point.cameras, *point.body), before))


def make_dense_camera_matrix(equations: PeriodicEquations) -> np.ndarray:
    """Return the matrix E of the cameras, (4 N, 4 N)."""
    out = np.zeros((FRAMES, 4, FRAMES, 4))
    for t in range(FRAMES):
        out[t, :, t] = equations.camera_prior[t]
        for d in range(min(2, FRAMES - 1 - t)):
            block = equations.camera_coupling[t, d]
            out[t + d + 1, :, t], out[t, :, t + d + 1] = block, block.T
    return out.reshape(FRAMES * 4, -1)


def keep(objective: PeriodicObjective, *terms: str) -> PeriodicObjective:
    """Return the objective with some of its terms."""
    return replace(
        objective,
        prior=objective.prior * ('prior' in terms),
        movement=tuple(
            replace(m, factors=m.factors * (f'movement {i}' in terms)) for i, m in enumerate(objective.movement)
        ),
        level_weight=objective.level_weight * ('level' in terms),
    )


@pytest.mark.parametrize('term', ['prior', 'movement 0', 'movement 1', 'level'])
def test_gradient_is_half_that_of_the_cost(
    objective_and_point: tuple[PeriodicObjective, Point], term: str
) -> None:
    objective, point = objective_and_point
    objective = keep(objective, term)
    equations = objective.normal_equations(point)
    numeric = differentiate(objective, point, lambda p: p.cost)[:, 0] / 2
    gradient = np.concatenate([equations.series_gradient, equations.camera_gradient.ravel()])
    assert np.abs(numeric).max() > 0
    assert np.abs(gradient - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_prior_is_weak_for_motion_and_strong_for_constants(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point
    equations = objective.normal_equations(point)
    np.testing.assert_array_equal(equations.series_prior[:-1], objective.prior.ravel())
    assert equations.series_prior[-1] == 0  # omega is free
    constant_heading = 3.0 * SolverConfig().prior_weight / CONSTANT_HEADING_STD**2
    assert objective.prior[0, -1] == pytest.approx(constant_heading)


def test_matrix_of_the_cameras_is_that_of_the_squares(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point

    def compute_residuals(p: Point) -> np.ndarray:
        matrices = measure_matrices(p.cameras)
        tilt = np.sqrt(objective.level_weight) * p.cameras.rotation[:, ::2, 2]
        return np.concatenate([*(m.residuals(matrices).ravel() for m in objective.movement), tilt.ravel()])

    jacobian = differentiate(objective, point, compute_residuals)[SERIES_UNKNOWNS:]
    expected = jacobian @ jacobian.T
    found = make_dense_camera_matrix(objective.normal_equations(point))
    assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


def test_movement_integrates_the_squared_derivatives(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, _ = objective_and_point
    times = objective.body.batch.times
    velocity, acceleration = objective.movement
    line = (0.7 * times + 5)[:, None] * np.ones(6)
    assert (velocity.residuals(line) ** 2).sum() == pytest.approx(6 * 0.02 * 0.7**2 * np.ptp(times))
    middle = (times[2:] - times[:-2]) / 2
    parabola = (times**2)[:, None] * np.ones(6)
    assert (acceleration.residuals(parabola) ** 2).sum() == pytest.approx(6 * 0.001 * 4 * middle.sum())
    still = objective.with_still_camera(CONFIG).movement[0]
    np.testing.assert_allclose(still.factors**2, 300 * velocity.factors**2)
