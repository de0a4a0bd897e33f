# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the periodic solver: cadence, missing points, and extreme input."""

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
from mocap_ros.solvers.joint.solver import WARM_DAMPING
from mocap_ros.solvers.levenberg_marquardt import DAMPING_AFTER_SUCCESS
from mocap_ros.solvers.periodic.fourier import fit_initial_series
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.objective import PeriodicObjective
from mocap_ros.solvers.periodic.solver import Search, measure_initial_point
from mocap_ros.solvers.stepwise import run_to_end
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
@settings(max_examples=60)
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
    solve_step = PeriodicEquations.solve_step

    def count_and_solve(equations: PeriodicEquations, damping: float) -> object:
        trials.append(damping)
        return solve_step(equations, damping)

    monkeypatch.setattr(PeriodicEquations, 'solve_step', count_and_solve)
    points = 1000 * np.random.default_rng(0).standard_normal((60, 15, 2))
    window = Window(points, np.ones((60, 15)), np.arange(60) / 30)
    config = SolverConfig(components=10, max_iterations=20, tolerance=0.0)
    (result,) = periodic.solve([window], walk_model, config)
    assert len(trials) == 20
    assert result.iterations == 20
    assert result.status is SolverStatus.MAX_ITERATIONS
    assert not result.success


def test_a_run_goes_on_with_the_damping_after_a_success(walk_model: BasePoses) -> None:
    """A run that has converged ended with a step that was taken."""
    theta, cameras, points, times = make_walk(walk_model, frames=20)
    model, config = walk_model.truncate(6), SolverConfig()
    objective = PeriodicObjective.build(Window(points, np.ones(points.shape[:2]), times), 200.0, model, config)
    series = fit_initial_series(theta[:, :6], times, config)
    start = InitialValues(theta[:, :6], cameras)
    search = Search(objective, measure_initial_point(objective, series, start, 200.0), max_trials=4)
    run_to_end(search.run(tolerance=1e9))
    assert search.status.name == 'CONVERGED'
    assert search.damping == pytest.approx(WARM_DAMPING * DAMPING_AFTER_SUCCESS)
    assert (search.remaining_trials, len(search.history)) == (3, 2)
    run_to_end(search.run(tolerance=0.0))
    assert search.status.name == 'MAX_ITERATIONS'
    assert (search.remaining_trials, len(search.history)) == (0, 5)
    assert search.history[-1] == pytest.approx(search.point.cost, rel=1e-12)
    run_to_end(search.run(tolerance=1e9))
    assert search.status is SolverStatus.MAX_ITERATIONS  # nothing was tried
