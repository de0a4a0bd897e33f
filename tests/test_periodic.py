"""The periodic model: it finds the cadence, its derivatives are right, it bridges what is missing."""

import dataclasses

import numpy as np
import pytest
from test_alternation import OPTICAL, mpjpe

from mocap_ros import nonperiodic, periodic
from mocap_ros.base_poses import BasePoses
from mocap_ros.camera import Cameras, small_rotation
from mocap_ros.config import SolverConfig
from mocap_ros.nonperiodic import Problem
from mocap_ros.periodic import Series
from mocap_ros.reconstruction import Start, Window

CADENCE = 0.9


def gait(model: BasePoses, frames: int = 70, seed: int = 0):
    """Two harmonics of one fundamental in four weights, seen from the side, at irregular times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.02, 0.05, frames))
    angle = 2 * np.pi * CADENCE * times[:, None]
    theta = np.zeros((frames, len(model.std)))
    phase = rng.uniform(0, 6, (2, 4))
    theta[:, :4] = model.std[:4] * (np.sin(angle + phase[0]) + 0.4 * np.sin(2 * angle + phase[1]))
    rotation = np.tile(OPTICAL @ small_rotation(np.array([0, 0, 0.9])), (frames, 1, 1))
    cameras = Cameras(np.full(frames, 200.0), rotation)
    points = cameras.project(model.poses(theta)) + [320.0, 240.0]
    return theta, cameras, points, times


def test_finds_cadence_and_motion(walk_model: BasePoses) -> None:
    theta, cameras, points, times = gait(walk_model)
    (result,) = periodic.solve(
        [Window(points, np.ones(points.shape[:2]), times)],
        walk_model,
        SolverConfig(components=10, bone_weight=0.1),
    )
    assert result.cadence == pytest.approx(CADENCE, rel=0.01)
    assert mpjpe(result, walk_model, theta, cameras) < 12
    assert (np.diff(result.objective) <= 0).all()


def test_missing_points_cost_little(walk_model: BasePoses) -> None:
    theta, cameras, points, times = gait(walk_model)
    weight = (np.random.default_rng(2).random(points.shape[:2]) > 0.2).astype(float)
    weight[:, [3, 4]] = 0
    config = SolverConfig(components=10)
    (whole,) = periodic.solve([Window(points, np.ones_like(weight), times)], walk_model, config)
    (holed,) = periodic.solve([Window(points, weight, times)], walk_model, config)
    assert mpjpe(holed, walk_model, theta, cameras) < 1.5 * mpjpe(whole, walk_model, theta, cameras) + 5


@pytest.mark.parametrize('sines', [False, True])
def test_gradient_agrees_with_finite_differences(walk_model: BasePoses, sines: bool) -> None:
    _, cameras, points, times = gait(walk_model, frames=20)
    model = walk_model.truncated(4)
    rng = np.random.default_rng(1)
    config = SolverConfig(smooth_weight=0.0, paper_sines=sines)
    problem = Problem.build([Window(points, np.ones(points.shape[:2]), times)], np.array([200.0]), model, config)
    rows = 2 if sines else 5
    omega = 2 * np.pi * (CADENCE + (0.1 * rng.random(4) if sines else 0.05))
    series = Series(
        0.05 * rng.normal(size=(rows, 4)), np.broadcast_to(omega, (4,)).copy(), sines, float(times.mean())
    )
    base = nonperiodic.initial_state(problem, [Start(series.theta(times), cameras)], np.array([200.0]))
    for _ in range(100):
        base = problem.best_translation(base)
    reduced = periodic._Reduced.build(problem.normal_equations(base), series, times, len(times))

    def cost(step: np.ndarray) -> float:
        moved = series.moved(step)
        return float(problem.cost(dataclasses.replace(base, theta=moved.theta(times)))[0])

    numeric = np.empty((rows + 1, 4))
    for index in np.ndindex(numeric.shape):
        step = np.zeros_like(numeric)
        step[index] = 1e-5
        numeric[index] = (cost(step) - cost(-step)) / 2e-5 / 2
    expected = numeric.ravel() if sines else np.append(numeric[:-1].ravel(), numeric[-1].sum())
    assert np.abs(reduced.gradient - expected).max() < 1e-6 * np.abs(expected).max()


def test_the_papers_sines_have_no_constant_and_their_own_frequencies(walk_model: BasePoses) -> None:
    _, _, points, times = gait(walk_model)
    config = SolverConfig(components=6, paper_sines=True)
    (result,) = periodic.solve([Window(points, np.ones(points.shape[:2]), times)], walk_model, config)
    assert result.series.coefficients.shape == (2, 6)
    assert len(set(np.round(result.series.omega, 6))) > 1
    assert (np.diff(result.objective) <= 0).all()
