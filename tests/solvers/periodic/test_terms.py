# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every term of the periodic objective alone: its gradient is that of its cost, its matrix that of its squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.block_banded import Coupling
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.camera_movement import CameraMovement, camera_matrices, make_camera_bands
from mocap_ros.solvers.periodic.coefficient_prior import CONSTANT_HEADING_STD, CoefficientPrior
from mocap_ros.solvers.periodic.fourier import FourierSeries
from mocap_ros.solvers.periodic.level_cameras import LevelCameras
from mocap_ros.solvers.periodic.normal_equations import COUPLED_FRAMES, PeriodicEquations, Step
from mocap_ros.solvers.periodic.objective import PeriodicObjective
from mocap_ros.solvers.periodic.point import Point
from mocap_ros.solvers.periodic.term import Term
from mocap_ros.solvers.window import Window
from tests.support.dense_matrices import make_dense_coupling
from tests.support.synthetic_walk import make_walk

COMPONENTS, HARMONICS, FRAMES = 4, 2, 7
PRIOR_FACTOR = 3.0
VELOCITY_WEIGHT, ACCELERATION_WEIGHT = 0.02, 0.001
SERIES_UNKNOWNS = (2 * HARMONICS + 1) * (COMPONENTS + 1) + 1
STEP = 1e-5  # of the finite differences: errors of rounding and of the third order are about equal
TERMS = (CoefficientPrior, CameraMovement, LevelCameras)
AnyTerm = TypeVar('AnyTerm', bound=Term)


@pytest.fixture
def objective_and_point(walk_model: BasePoses, rng: np.random.Generator) -> tuple[PeriodicObjective, Point]:
    """A window at irregular times, and a point with tilted cameras that move."""
    model = walk_model.truncate(COMPONENTS)
    _, _, points, _ = make_walk(walk_model, frames=FRAMES)
    times = np.cumsum(rng.uniform(0.02, 0.05, FRAMES))
    config = SolverConfig(
        harmonics=HARMONICS,
        periodic_prior_factor=PRIOR_FACTOR,
        camera_velocity_weight=VELOCITY_WEIGHT,
        camera_acceleration_weight=ACCELERATION_WEIGHT,
    )
    objective = PeriodicObjective.build(Window(points, np.ones(points.shape[:2]), times), 200.0, model, config)
    shape = (2 * HARMONICS + 1, COMPONENTS + 1)
    series = FourierSeries(0.05 * rng.normal(size=shape), 2 * np.pi * 0.9, float(times.mean()))
    cameras = State(
        np.zeros((FRAMES, 0)),
        rotation_from_vector(rng.normal(size=(FRAMES, 3))),
        0.1 * rng.normal(size=FRAMES),
        rng.normal(size=(FRAMES, 2)),
    )
    return objective, objective.measure(series, cameras)


def find_term(objective: PeriodicObjective, kind: type[AnyTerm]) -> AnyTerm:
    return next(term for term in objective.terms if isinstance(term, kind))


def equations_of(term: Term, point: Point) -> PeriodicEquations:
    """The equations to which one term has added."""
    equations = PeriodicEquations(
        np.zeros((SERIES_UNKNOWNS, SERIES_UNKNOWNS)),
        np.zeros(SERIES_UNKNOWNS),
        np.zeros(SERIES_UNKNOWNS),
        np.zeros((FRAMES, CAMERA_UNKNOWNS, SERIES_UNKNOWNS)),
        np.zeros((FRAMES, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS)),
        np.zeros((FRAMES, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS)),
        Coupling.zeros(COUPLED_FRAMES, FRAMES, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS),
        np.zeros((FRAMES, CAMERA_UNKNOWNS)),
    )
    term.add_to(equations, point)
    return equations


def move(point: Point, step: np.ndarray) -> Point:
    """Return the point after a step of series and cameras in one vector."""
    cameras = step[SERIES_UNKNOWNS:].reshape(FRAMES, CAMERA_UNKNOWNS)
    parts = Step(step[:SERIES_UNKNOWNS], cameras)
    return replace(
        point, series=point.series.with_step(parts.series), cameras=point.cameras.advanced(parts.cameras)
    )


def differentiate(function: Callable[[Point], np.ndarray | float], point: Point) -> np.ndarray:
    """Return central differences of a function of the point by all unknowns, one in each row."""
    size = SERIES_UNKNOWNS + FRAMES * CAMERA_UNKNOWNS
    rows = []
    for step in STEP * np.eye(size):
        up, down = function(move(point, step)), function(move(point, -step))
        rows.append((np.asarray(up) - down).ravel() / (2 * STEP))
    return np.array(rows)


def dense_camera_matrix(equations: PeriodicEquations) -> np.ndarray:
    """Return the matrix E of the cameras, (4 N, 4 N)."""
    out = np.zeros((FRAMES, CAMERA_UNKNOWNS, FRAMES, CAMERA_UNKNOWNS))
    for t in range(FRAMES):
        out[t, :, t] = equations.camera_prior[t]
    for distance in (1, 2):
        for t, block in enumerate(make_dense_coupling(equations.camera_coupling, distance)):
            out[t + distance, :, t], out[t, :, t + distance] = block, block.T
    return out.reshape(FRAMES * CAMERA_UNKNOWNS, -1)


@pytest.mark.parametrize('kind', TERMS)
def test_gradient_is_half_that_of_the_cost(
    objective_and_point: tuple[PeriodicObjective, Point], kind: type[Term]
) -> None:
    objective, point = objective_and_point
    term = find_term(objective, kind)
    equations = equations_of(term, point)
    numeric = differentiate(term.cost, point)[:, 0] / 2
    gradient = np.concatenate([equations.series_gradient, equations.camera_gradient.ravel()])
    assert np.abs(numeric).max() > 0
    assert np.abs(gradient - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_matrix_of_the_prior_is_its_second_derivative(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point
    term = find_term(objective, CoefficientPrior)
    equations = equations_of(term, point)
    numeric = differentiate(lambda p: equations_of(term, p).series_gradient, point)[:SERIES_UNKNOWNS]
    assert np.diag(equations.series_prior) == pytest.approx(numeric, abs=1e-6 * equations.series_prior.max())
    assert equations.series_prior[-1] == 0  # omega is free
    assert equations.series_prior[COMPONENTS] == pytest.approx(
        PRIOR_FACTOR * SolverConfig().prior_weight / CONSTANT_HEADING_STD**2
    )


def test_matrix_of_level_cameras_is_that_of_the_squared_tilts(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point
    term = find_term(objective, LevelCameras)
    assert isinstance(term, LevelCameras)
    jacobian = differentiate(lambda p: p.cameras.rotation[:, ::2, 2], point)[SERIES_UNKNOWNS:]
    expected = term.weight * jacobian @ jacobian.T
    found = dense_camera_matrix(equations_of(term, point))
    assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


def test_matrix_of_the_movement_is_that_of_the_squared_differences(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, point = objective_and_point
    term = find_term(objective, CameraMovement)
    assert isinstance(term, CameraMovement)
    jacobian = differentiate(lambda p: camera_matrices(p.cameras), point)[SERIES_UNKNOWNS:]
    form = np.kron(dense_form(term.bands), np.eye(6))
    expected = jacobian @ form @ jacobian.T
    found = dense_camera_matrix(equations_of(term, point))
    assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize('frames', [1, 2, 3])
def test_few_frames_have_few_differences(
    objective_and_point: tuple[PeriodicObjective, Point], frames: int
) -> None:
    _, point = objective_and_point
    few = replace(point, cameras=point.cameras.select(np.arange(frames)))
    term = CameraMovement.build(np.arange(frames) / 30, 1.0, 1.0)
    matrices = camera_matrices(few.cameras)
    change = np.diff(matrices, axis=0) * 30
    expected = (change**2).sum() / 30 + (np.diff(change, axis=0) ** 2).sum() * 30
    assert term.cost(few) == pytest.approx(expected, rel=1e-9)


def dense_form(bands: np.ndarray) -> np.ndarray:
    """Return the symmetric matrix Q of its bands."""
    n = bands.shape[1]
    lower = sum(np.diag(bands[below, : n - below], -below) for below in range(3))
    return np.asarray(lower + np.tril(lower, -1).T)


def test_the_camera_has_the_weights_of_the_parameters(
    objective_and_point: tuple[PeriodicObjective, Point],
) -> None:
    objective, _ = objective_and_point
    bands = find_term(objective, CameraMovement).bands
    np.testing.assert_array_equal(bands, make_camera_bands(objective.times, VELOCITY_WEIGHT, ACCELERATION_WEIGHT))


def test_camera_bands_integrate_the_squared_derivatives(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.05, 9))
    form = dense_form(make_camera_bands(times, 2.0, 3.0))
    line = 0.7 * times + 5
    assert line @ form @ line == pytest.approx(2.0 * 0.7**2 * np.ptp(times))
    parabola = times**2
    middle = (times[2:] - times[:-2]) / 2
    first = (np.diff(parabola) ** 2 / np.diff(times)).sum()
    assert parabola @ form @ parabola == pytest.approx(2.0 * first + 3.0 * 4 * middle.sum())
