"""Tests of the periodic solver: cadence, derivatives, missing points, and extreme input."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint, periodic
from mocap_ros.solvers.periodic.fourier import FourierSeries
from mocap_ros.solvers.periodic.normal_equations import ReducedNormalEquations
from mocap_ros.solvers.periodic.objective import PeriodicObjective, make_camera_bands
from mocap_ros.solvers.window import InitialValues, SolverStatus, Window
from tests.support.synthetic_walk import BODY_TO_OPTICAL, Walk, compute_mpjpe

CADENCE = 0.9


def make_walk(model: BasePoses, frames: int = 70, seed: int = 0) -> Walk:
    """Return weights, cameras, points and times of a walk: four weights, two harmonics each, irregular times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.02, 0.05, frames))
    angle = 2 * np.pi * CADENCE * times[:, None]
    theta = np.zeros((frames, len(model.std)))
    phase = rng.uniform(0, 6, (2, 4))
    theta[:, :4] = model.std[:4] * (np.sin(angle + phase[0]) + 0.4 * np.sin(2 * angle + phase[1]))
    rotation = np.tile(BODY_TO_OPTICAL @ rotation_from_vector(np.array([0, 0, 0.9])), (frames, 1, 1))
    cameras = WeakPerspectiveCameras(np.full(frames, 200.0), rotation)
    points = cameras.project(model.poses(theta)) + [320.0, 240.0]
    return theta, cameras, points, times


def test_finds_cadence_and_motion(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    (result,) = periodic.solve(
        [Window(points, np.ones(points.shape[:2]), times)],
        walk_model,
        SolverConfig(components=10, bone_weight=0.1),
    )
    assert result.cadence == pytest.approx(CADENCE, rel=0.01)
    assert compute_mpjpe(result, walk_model, theta, cameras) < 1.1 * 8.4  # mm, measured
    assert (np.diff(result.history) <= 0).all()


def test_missing_points_increase_the_error_only_slightly(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    weight = (np.random.default_rng(2).random(points.shape[:2]) > 0.2).astype(float)
    weight[:, [3, 4]] = 0
    config = SolverConfig(components=10)
    (complete,) = periodic.solve([Window(points, np.ones_like(weight), times)], walk_model, config)
    (incomplete,) = periodic.solve([Window(points, weight, times)], walk_model, config)
    assert compute_mpjpe(incomplete, walk_model, theta, cameras) < 1.1 * 27.1  # mm, measured; all points: 24.6 mm
    assert compute_mpjpe(complete, walk_model, theta, cameras) < 1.1 * 24.6  # mm, measured


def test_gradient_and_matrix_agree_with_finite_differences(walk_model: BasePoses) -> None:
    _, cameras, points, times = make_walk(walk_model, frames=12)
    model = walk_model.truncate(4)
    rng = np.random.default_rng(1)
    config = SolverConfig(harmonics=2, robust_scale=0.0)
    window = Window(points, np.ones(points.shape[:2]), times)
    objective = PeriodicObjective.build(window, 200.0, model, config)
    omega = 2 * np.pi * (CADENCE + 0.05)
    series = FourierSeries(0.05 * rng.normal(size=(5, 5)), omega, float(times.mean()))
    unknowns = series.coefficients.size + 1
    start = InitialValues(series.evaluate(times)[:, :-1], cameras)
    base = objective.problem.initial_state([start], np.array([200.0]))
    perturbation = np.concatenate([np.zeros_like(base.theta), 0.05 * rng.normal(size=(12, 4))], axis=1)
    base = base.advanced(perturbation)

    def compute_cost(step: np.ndarray) -> float:
        series_step, camera_step = np.split(step, [unknowns])
        moved = series.with_step(series_step)
        padded = np.concatenate([np.zeros_like(base.theta), camera_step.reshape(12, 4)], axis=1)
        return objective.cost(moved, objective.with_optimal_translation(moved, base.advanced(padded)))

    size = unknowns + 48
    numeric = np.empty(size)
    for index in range(size):
        step = np.zeros(size)
        step[index] = 1e-5
        numeric[index] = (compute_cost(step) - compute_cost(-step)) / 2e-5 / 2
    reduced = ReducedNormalEquations.build(objective, series, objective.with_optimal_translation(series, base))
    analytic = np.concatenate([reduced.series_gradient, reduced.camera_gradient])
    assert np.abs(analytic - numeric).max() < 1e-6 * np.abs(numeric).max()

    # Without damping the step solves the whole system, in which the cameras are not eliminated.
    full_step = reduced.solve_step(0.0)
    assert full_step is not None
    full_matrix = np.block(
        [[reduced.series_matrix, reduced.coupling], [reduced.coupling.T, unpack_band(reduced.camera_band)]]
    )
    expected = -np.linalg.solve(full_matrix + 1e-12 * np.eye(len(full_matrix)), analytic)
    found = np.concatenate([full_step[0], full_step[1].ravel()])
    assert np.allclose(found, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


def unpack_band(band: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix from LAPACK's lower band storage."""
    n = band.shape[1]
    lower = sum(np.diag(band[below, : n - below], -below) for below in range(min(len(band), n)))
    return np.asarray(lower + np.tril(lower, -1).T)


def test_camera_bands_integrate_the_squared_derivatives(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.05, 9))
    bands = make_camera_bands(times, 2.0, 3.0)
    form = sum(np.diag(bands[d, : 9 - d], -d) + (np.diag(bands[d, : 9 - d], d) if d else 0) for d in range(3))
    line = 0.7 * times + 5
    assert line @ form @ line == pytest.approx(2.0 * 0.7**2 * np.ptp(times))
    parabola = times**2
    middle = (times[2:] - times[:-2]) / 2
    first = (np.diff(parabola) ** 2 / np.diff(times)).sum()
    assert parabola @ form @ parabola == pytest.approx(2.0 * first + 3.0 * 4 * middle.sum())


def test_heading_of_the_body_does_not_move_the_camera(walk_model: BasePoses) -> None:
    theta, cameras, _, times = make_walk(walk_model)
    turn = 0.2 * np.sin(2 * np.pi * CADENCE * times)
    turned = WeakPerspectiveCameras(
        cameras.scale, cameras.rotation @ rotation_from_vector(np.stack([0 * turn, 0 * turn, turn], -1))
    )
    points = turned.project(walk_model.poses(theta)) + [320.0, 240.0]
    (result,) = periodic.solve(
        [Window(points, np.ones(points.shape[:2]), times)], walk_model, SolverConfig(components=10)
    )
    heading = result.series.evaluate_heading(times)
    camera = result.cameras.rotation @ rotation_from_vector(np.stack([0 * turn, 0 * turn, -heading], -1))
    camera_turn = np.degrees(np.linalg.norm(camera - camera.mean(axis=0), axis=(1, 2)) / np.sqrt(2))
    assert np.ptp(heading) == pytest.approx(0.4, abs=0.01)  # measured: 0.394
    assert np.sqrt((camera_turn**2).mean()) < 1.1 * 1.2  # degrees, measured


def test_initial_poses_are_used(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    window = Window(points, np.ones(points.shape[:2]), times)
    config = SolverConfig(components=10)
    (initial,) = joint.solve([window], walk_model.truncate(20), replace(config, components=20))
    (without_initial,) = periodic.solve([window], walk_model, config)
    poses = periodic.EstimatedPoses(initial.joints, initial.cameras.scale, initial.noise)
    (with_initial,) = periodic.solve([window], walk_model, config, [poses])
    max_error = 1.2 * compute_mpjpe(without_initial, walk_model, theta, cameras)
    assert compute_mpjpe(with_initial, walk_model, theta, cameras) < max_error


@given(
    frames=st.integers(1, 6),
    spread=st.floats(-307, 307),
    offset=st.floats(-307, 307),
    weight=st.floats(-300, 300),
    step=st.sampled_from([1e-300, 1e-9, 1 / 30, 1e9, 1e300]),
    given_noise=st.sampled_from([None, 1e-300, 1.0, 1e300]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=60, deadline=None)
def test_extreme_input_is_rejected_or_gives_finite_results(
    walk_model: BasePoses,
    frames: int,
    spread: float,
    offset: float,
    weight: float,
    step: float,
    given_noise: float | None,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    points = 10**offset + 10**spread * rng.uniform(-1, 1, (frames, 15, 2))
    seen = np.full((frames, 15), 10**weight)
    window = Window(points, seen, np.array([step * frame for frame in range(frames)]), noise=given_noise)
    config = SolverConfig(components=6, max_iterations=8)
    try:
        (result,) = periodic.solve([window], walk_model, config)
    except InputError:
        return
    assert np.isfinite(result.joints).all()
    assert np.isfinite(result.cameras.scale).all()
    assert np.isfinite(result.translation).all()
    assert np.isfinite(result.history).all()
    assert (np.diff(result.history) <= 0).all()


def test_max_iterations_limits_the_trials_on_random_points(
    walk_model: BasePoses, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials = []
    solve_step = ReducedNormalEquations.solve_step

    def count_and_solve(equations: ReducedNormalEquations, damping: float) -> object:
        trials.append(damping)
        return solve_step(equations, damping)

    monkeypatch.setattr(ReducedNormalEquations, 'solve_step', count_and_solve)
    points = 1000 * np.random.default_rng(0).standard_normal((60, 15, 2))
    window = Window(points, np.ones((60, 15)), np.arange(60) / 30)
    config = SolverConfig(components=10, max_iterations=20, tolerance=0.0)
    (result,) = periodic.solve([window], walk_model, config)
    assert len(trials) == 20
    assert result.iterations == 20
    assert result.status is SolverStatus.MAX_ITERATIONS
    assert not result.success
