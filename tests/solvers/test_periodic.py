"""The periodic model: it finds the cadence, its derivatives are right, it bridges what is missing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import small_rotation
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint, periodic
from mocap_ros.solvers.joint.objective import initial_state
from mocap_ros.solvers.periodic.fourier import Series
from mocap_ros.solvers.periodic.normal_equations import Reduced
from mocap_ros.solvers.periodic.objective import Objective, roughness
from mocap_ros.solvers.window import Start, Window
from tests.support.synthetic_walk import OPTICAL, mpjpe

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
def test_gradient_and_matrix_agree_with_finite_differences(walk_model: BasePoses, sines: bool) -> None:
    _, cameras, points, times = gait(walk_model, frames=12)
    model = walk_model.truncated(4)
    rng = np.random.default_rng(1)
    config = SolverConfig(paper_sines=sines, harmonics=2, robust_scale=0.0)
    window = Window(points, np.ones(points.shape[:2]), times)
    objective = Objective.build(window, 200.0, model, config)
    rows = 2 if sines else 5
    omega = 2 * np.pi * (CADENCE + (0.1 * rng.random(5) if sines else 0.05))
    series = Series(
        0.05 * rng.normal(size=(rows, 5)), np.broadcast_to(omega, (5,)).copy(), sines, float(times.mean())
    )
    start = Start(series.theta(times), cameras)
    base = initial_state(objective.problem, [start], np.array([200.0]))
    jolt = np.concatenate([np.zeros_like(base.theta), 0.05 * rng.normal(size=(12, 4))], axis=1)
    base = base.moved(jolt)

    def cost(step: np.ndarray) -> float:
        of_series, of_cameras = np.split(step, [(rows + 1) * 5])
        moved = series.moved(of_series.reshape(rows + 1, 5))
        padded = np.concatenate([np.zeros_like(base.theta), of_cameras.reshape(12, 4)], axis=1)
        return objective.cost(moved, objective.best_translation(moved, base.moved(padded)))

    size = (rows + 1) * 5 + 48
    numeric = np.empty(size)
    for index in range(size):
        step = np.zeros(size)
        step[index] = 1e-5
        numeric[index] = (cost(step) - cost(-step)) / 2e-5 / 2
    if not sines:
        omegas = slice(rows * 5, (rows + 1) * 5)
        numeric = np.concatenate([numeric[: rows * 5], [numeric[omegas].sum()], numeric[omegas.stop :]])
    reduced = Reduced.build(objective, series, objective.best_translation(series, base))
    analytic = np.concatenate([reduced.gradient, reduced.camera_gradient])
    assert np.abs(analytic - numeric).max() < 1e-6 * np.abs(numeric).max()

    # the step without damping solves the whole system at once, cameras not eliminated
    step = reduced.step(0.0)
    assert step is not None
    whole = np.block([[reduced.matrix, reduced.coupling], [reduced.coupling.T, dense(reduced.band)]])
    expected = -np.linalg.solve(whole + 1e-12 * np.eye(len(whole)), analytic)
    found = np.concatenate([step[0].ravel()[: len(reduced.gradient)], step[1].ravel()])
    assert np.allclose(found, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


def dense(band: np.ndarray) -> np.ndarray:
    """A symmetric matrix from LAPACK's lower band storage."""
    n = band.shape[1]
    lower = sum(np.diag(band[below, : n - below], -below) for below in range(min(len(band), n)))
    return np.asarray(lower + np.tril(lower, -1).T)


def test_roughness_is_the_integral_of_squared_derivatives(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.05, 9))
    bands = roughness(times, 2.0, 3.0)
    form = sum(np.diag(bands[d, : 9 - d], -d) + (np.diag(bands[d, : 9 - d], d) if d else 0) for d in range(3))
    line = 0.7 * times + 5
    assert line @ form @ line == pytest.approx(2.0 * 0.7**2 * np.ptp(times))
    parabola = times**2
    middle = (times[2:] - times[:-2]) / 2
    first = (np.diff(parabola) ** 2 / np.diff(times)).sum()
    assert parabola @ form @ parabola == pytest.approx(2.0 * first + 3.0 * 4 * middle.sum())


def test_a_turning_body_leaves_the_camera_still(walk_model: BasePoses) -> None:
    theta, cameras, _, times = gait(walk_model)
    turn = 0.2 * np.sin(2 * np.pi * CADENCE * times)
    turned = Cameras(cameras.scale, cameras.rotation @ small_rotation(np.stack([0 * turn, 0 * turn, turn], -1)))
    points = turned.project(walk_model.poses(theta)) + [320.0, 240.0]
    (result,) = periodic.solve(
        [Window(points, np.ones(points.shape[:2]), times)], walk_model, SolverConfig(components=10)
    )
    heading = result.series.heading(times)
    camera = result.cameras.rotation @ small_rotation(np.stack([0 * turn, 0 * turn, -heading], -1))
    wobble = np.degrees(np.linalg.norm(camera - camera.mean(axis=0), axis=(1, 2)) / np.sqrt(2))
    assert np.ptp(heading) == pytest.approx(0.4, abs=0.15)
    assert np.sqrt((wobble**2).mean()) < 3


def test_starts_from_what_the_caller_has(walk_model: BasePoses) -> None:
    theta, cameras, points, times = gait(walk_model)
    window = Window(points, np.ones(points.shape[:2]), times)
    config = SolverConfig(components=10)
    (begun,) = joint.solve([window], walk_model.truncated(20), replace(config, components=20))
    (afresh,) = periodic.solve([window], walk_model, config)
    (result,) = periodic.solve([window], walk_model, config, [begun])
    (again,) = periodic.solve([window], walk_model, config, [begun], [result.series])
    worst = 1.2 * mpjpe(afresh, walk_model, theta, cameras)
    assert mpjpe(result, walk_model, theta, cameras) < worst
    assert mpjpe(again, walk_model, theta, cameras) < worst
    assert again.cadence == pytest.approx(CADENCE, rel=0.01)


@given(
    frames=st.integers(1, 6),
    spread=st.floats(-307, 307),
    offset=st.floats(-307, 307),
    weight=st.floats(-300, 300),
    step=st.sampled_from([1e-300, 1e-9, 1 / 30, 1e9, 1e300]),
    known_noise=st.sampled_from([None, 1e-300, 1.0, 1e300]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=60, deadline=None)
def test_extreme_input_is_refused_or_gives_numbers(
    walk_model: BasePoses,
    frames: int,
    spread: float,
    offset: float,
    weight: float,
    step: float,
    known_noise: float | None,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    points = 10**offset + 10**spread * rng.uniform(-1, 1, (frames, 15, 2))
    seen = np.full((frames, 15), 10**weight)
    window = Window(points, seen, step * np.arange(frames), noise=known_noise)
    config = SolverConfig(components=6, max_iterations=8)
    try:
        (result,) = periodic.solve([window], walk_model, config)
    except InputError:
        return
    assert np.isfinite(result.joints).all()
    assert np.isfinite(result.cameras.scale).all()
    assert np.isfinite(result.translation).all()
    assert np.isfinite(result.objective).all()
    assert (np.diff(result.objective) <= 0).all()


def test_tries_bound_the_steps_on_garbage(walk_model: BasePoses, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    step = Reduced.step
    monkeypatch.setattr(Reduced, 'step', lambda self, damping: tried.append(1) or step(self, damping))
    points = 1000 * np.random.default_rng(0).standard_normal((60, 15, 2))
    window = Window(points, np.ones((60, 15)), np.arange(60) / 30)
    periodic.solve([window], walk_model, SolverConfig(components=10, max_iterations=20, tolerance=0.0))
    assert len(tried) <= 20


def test_the_papers_sines_have_no_constant_and_their_own_frequencies(walk_model: BasePoses) -> None:
    _, _, points, times = gait(walk_model)
    config = SolverConfig(components=6, paper_sines=True)
    (result,) = periodic.solve([Window(points, np.ones(points.shape[:2]), times)], walk_model, config)
    assert result.series.coefficients.shape == (2, 7)
    assert len(set(np.round(result.series.omega, 6))) > 1
    assert (np.diff(result.objective) <= 0).all()
