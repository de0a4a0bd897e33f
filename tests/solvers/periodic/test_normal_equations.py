# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The normal equations of the periodic model against dense matrices and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.batch import State
from mocap_ros.solvers.periodic.fourier import FourierSeries
from mocap_ros.solvers.periodic.normal_equations import (
    MIN_CAMERA_INFORMATION,
    MIN_INFORMATION,
    PeriodicEquations,
    insert_heading,
)
from mocap_ros.solvers.periodic.objective import PeriodicObjective, Point, move_cameras
from mocap_ros.solvers.window import Window
from tests.support.synthetic_walk import make_walk

COMPONENTS, HARMONICS, FRAMES = 4, 2, 12
SERIES_UNKNOWNS = (2 * HARMONICS + 1) * (COMPONENTS + 1) + 1
STEP = 1e-5  # of the finite differences: errors of rounding and of the third order are about equal


@pytest.fixture
def objective_and_point(walk_model: BasePoses, rng: np.random.Generator) -> tuple[PeriodicObjective, Point]:
    """Seen points without robust loss, so that the step to the best translations reaches them."""
    model = walk_model.truncate(COMPONENTS)
    _, cameras, points, _ = make_walk(walk_model, frames=FRAMES)
    times = np.cumsum(rng.uniform(0.02, 0.05, FRAMES))
    config = SolverConfig(harmonics=HARMONICS, robust_scale=0.0)
    objective = PeriodicObjective.build(Window(points, np.ones(points.shape[:2]), times), 200.0, model, config)
    shape = (2 * HARMONICS + 1, COMPONENTS + 1)
    series = FourierSeries(0.05 * rng.normal(size=shape), 2 * np.pi * 0.95, float(times.mean()))
    state = State(
        np.zeros((FRAMES, 0)),
        rotation_from_vector(0.05 * rng.normal(size=(FRAMES, 3))) @ cameras.rotation,
        np.log(cameras.scale / 200) + 0.05 * rng.normal(size=FRAMES),
        np.zeros((FRAMES, 2)),
    )
    return objective, objective.measure(series, state)


def dense_matrices(equations: PeriodicEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the matrices A, B, C and the part E of C that does not come from the image."""
    prior = np.zeros((FRAMES, CAMERA_UNKNOWNS, FRAMES, CAMERA_UNKNOWNS))
    image = prior.copy()
    for t in range(FRAMES):
        prior[t, :, t], image[t, :, t] = equations.camera_prior[t], equations.camera_image[t]
    for distance in (1, 2):
        for t, block in enumerate(equations.camera_coupling[:-distance, distance - 1]):
            prior[t + distance, :, t], prior[t, :, t + distance] = block, block.T
    size = FRAMES * CAMERA_UNKNOWNS
    prior_matrix, image_matrix = prior.reshape(size, size), image.reshape(size, size)
    series = equations.series_matrix + np.diag(equations.series_prior)
    return series, equations.mixed_matrix.reshape(size, -1).T, image_matrix + prior_matrix, prior_matrix


def test_gradient_is_half_that_of_the_objective(objective_and_point: tuple[PeriodicObjective, Point]) -> None:
    objective, point = objective_and_point

    def compute_cost(step: np.ndarray) -> float:
        series = point.series.with_step(step[:SERIES_UNKNOWNS])
        cameras = move_cameras(point.cameras, step[SERIES_UNKNOWNS:].reshape(FRAMES, CAMERA_UNKNOWNS))
        return objective.measure(series, cameras).cost

    size = SERIES_UNKNOWNS + FRAMES * CAMERA_UNKNOWNS
    steps = STEP * np.eye(size)
    numeric = np.array([(compute_cost(s) - compute_cost(-s)) / (2 * STEP) / 2 for s in steps])
    equations = objective.normal_equations(point)
    analytic = np.concatenate([equations.series_gradient, equations.camera_gradient.ravel()])
    assert np.abs(analytic - numeric).max() < 1e-6 * np.abs(numeric).max()


@pytest.mark.parametrize('damping', [0.0, 0.3])
def test_step_solves_the_equations_in_which_the_cameras_are_not_eliminated(
    objective_and_point: tuple[PeriodicObjective, Point], damping: float
) -> None:
    objective, point = objective_and_point
    equations = objective.normal_equations(point)
    series, mixed, cameras, _ = dense_matrices(equations)
    matrix = np.block([[series, mixed], [mixed.T, cameras]])
    matrix += damping * np.diag(np.diag(matrix)) + MIN_INFORMATION * np.eye(len(matrix))
    gradient = np.concatenate([equations.series_gradient, equations.camera_gradient.ravel()])
    expected = -np.linalg.solve(matrix, gradient)
    step = equations.solve_step(damping)
    assert step is not None
    found = np.concatenate([step.series, step.cameras.ravel()])
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-6 * np.abs(expected).max())


def test_a_matrix_that_is_not_definite_gives_no_step(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point
    for name in ('camera_prior', 'series_matrix'):
        equations = objective.normal_equations(point)
        getattr(equations, name)[...] -= 1e6 * np.eye(getattr(equations, name).shape[-1])
        assert equations.solve_step(1e-3) is None


def test_counts_and_determinants_are_those_of_the_dense_matrices(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point
    equations = objective.normal_equations(point)
    series, _, cameras, prior = dense_matrices(equations)
    small = np.eye(CAMERA_UNKNOWNS) * MIN_INFORMATION
    blocks = cameras.reshape(FRAMES, CAMERA_UNKNOWNS, FRAMES, CAMERA_UNKNOWNS)
    expected = SERIES_UNKNOWNS - np.trace(np.linalg.solve(series, np.diag(equations.series_prior)))
    for t in range(FRAMES):
        expected += np.trace(np.linalg.solve(blocks[t, :, t] + small, equations.camera_image[t])) + 2
    assert equations.count_effective_parameters() == pytest.approx(expected, rel=1e-6)
    both = [np.linalg.slogdet(m + MIN_CAMERA_INFORMATION * np.eye(len(m)))[1] for m in (cameras, prior)]
    assert equations.camera_log_determinant_ratio() == pytest.approx(both[0] - both[1], rel=1e-6)


def test_heading_is_inserted_by_the_chain_rule(objective_and_point: tuple[PeriodicObjective, Point]) -> None:
    objective, point = objective_and_point
    objective.normal_equations(point)
    body = objective.problem
    vertical = point.cameras.rotation[:, :, 2]
    matrix, gradient, bones = insert_heading(body, vertical)
    k = COMPONENTS
    transform = np.zeros((FRAMES, k + 4, k + 5))  # d (theta, v, log s) / d (theta, psi, w, log s)
    transform[:, range(k), range(k)] = 1
    transform[:, range(k, k + 4), range(k + 1, k + 5)] = 1
    transform[:, k : k + 3, k] = vertical
    lower = np.tril(body.diagonal)
    symmetric = lower + np.swapaxes(np.tril(lower, -1), 1, 2)
    expected = np.einsum('tia,tij,tjb->tab', transform, symmetric, transform)
    assert matrix == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert gradient == pytest.approx(np.einsum('tia,ti->ta', transform, body.gradient), rel=1e-12)
    expected = np.einsum('tia,tib->tab', transform, body.bone_vectors)[:, : k + 1]
    assert bones == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_products_of_the_series_are_those_of_its_jacobian(
    objective_and_point: tuple[PeriodicObjective, Point], rng: np.random.Generator
) -> None:
    objective, point = objective_and_point
    jacobian = point.series.jacobian(objective.body.batch.times)
    dense = np.empty((FRAMES, COMPONENTS + 1, SERIES_UNKNOWNS))
    for i, step in enumerate(STEP * np.eye(SERIES_UNKNOWNS)):
        up, down = (point.series.with_step(s).evaluate(objective.body.batch.times) for s in (step, -step))
        dense[:, :, i] = (up - down) / (2 * STEP)
    x = rng.normal(size=(FRAMES, 3, COMPONENTS + 1))
    assert jacobian.products(x) == pytest.approx(x @ dense, abs=1e-8)
    assert jacobian.sum_products(x) == pytest.approx((x @ dense).sum(axis=0), abs=1e-8)
    symmetric = rng.normal(size=(FRAMES, COMPONENTS + 1, COMPONENTS + 1))
    symmetric = symmetric + np.swapaxes(symmetric, 1, 2)
    expected = np.einsum('tia,tij,tjb->ab', dense, symmetric, dense)
    assert jacobian.sum_congruences(symmetric) == pytest.approx(expected, abs=1e-7)
