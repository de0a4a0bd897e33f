# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The periodic solver against finite differences and dense matrices, on walks and on extreme input; which motion
is periodic, with its hysteresis, and which prior leads."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from mocap_ros.arrays import Array
from mocap_ros.config import ClassifierConfig, Config, SolverConfig
from mocap_ros.demo.motions import load_motions
from mocap_ros.engine.periodic import measure_repetition
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline import whole_sequence
from mocap_ros.solvers import periodic
from mocap_ros.solvers.classification import (
    MAX_STRETCH,
    REPEATED_S,
    PeriodicFit,
    fit_periodic_stepwise,
    is_periodic,
    measure_best_repetition,
    measure_jitter,
)
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.leading_prior import MAX_NOISE, MAX_NOISE_RATIO, NEGLIGIBLE_NOISE, explains_as_well
from mocap_ros.solvers.levenberg_marquardt import run_to_end
from mocap_ros.solvers.periodic import EstimatedPoses, build_body, build_cameras, build_problem
from mocap_ros.solvers.periodic_equations import PeriodicProblem, Point, fit_series
from mocap_ros.solvers.window import InitialValues, Window
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.plain_objective import compute_residuals
from tests.support.synthetic_walk import (
    BODY_TO_OPTICAL,
    STEP_NS,
    Walk,
    feed,
    make_sequence,
    make_walk,
    mpjpe_mm,
    with_scores,
)
from tests.support.whole_sequence import reconstruct_sequence

COMPONENTS, HARMONICS, FRAMES = 4, 2, 8
CONFIG = SolverConfig(
    harmonics=HARMONICS,
    robust_scale=0.0,
    periodic_prior_factor=3.0,
    camera_velocity_weight=0.02,
    camera_acceleration_weight=0.001,
)
SERIES_UNKNOWNS = (2 * HARMONICS + 1) * (COMPONENTS + 1) + 1
STEP = 1e-5  # of the finite differences: errors of rounding and of the third order are about equal
MIN_INFORMATION, MIN_CAMERA_INFORMATION = 1e-12, 1e-6  # what is added to diagonals, of determinants the latter


class Case(NamedTuple):
    """The objective of a window, and some values of the unknowns."""

    batch: Batch
    model: PoseModel
    config: SolverConfig
    values: Point
    times: np.ndarray  # s from the origin of the series

    def measure(self, values: Point | None = None, settle_steps: int = 1) -> PeriodicProblem:
        body = build_body(self.batch, self.model, self.config)
        cameras = build_cameras(self.batch, self.model, self.config)
        return build_problem(body, cameras, values or self.values, self.model, self.config, settle_steps)


def make_case(walk_model: PoseModel, rng: np.random.Generator, term: str) -> Case:
    """All points seen and cameras near the true ones, or almost nothing seen and tilted cameras that move.

    Without robust loss, so that the step to the best translations reaches them. A term other than `image` is the
    only one.
    """
    model = walk_model.truncate(COMPONENTS)
    _, cameras, points, _ = make_walk(walk_model, frames=FRAMES)
    times, weight = np.cumsum(rng.uniform(0.02, 0.05, FRAMES)), np.ones(points.shape[:2])
    config, rotation = CONFIG, rotation_from_vector(0.05 * rng.normal(size=(FRAMES, 3))) @ cameras.rotation
    if term != 'all':
        prior_factor = CONFIG.periodic_prior_factor if term == 'prior' else 0.0
        movement_share = float(term in {'movement', 'cameras'})
        config = replace(
            CONFIG,
            periodic_prior_factor=prior_factor,
            camera_velocity_weight=movement_share * CONFIG.camera_velocity_weight,
            camera_acceleration_weight=movement_share * CONFIG.camera_acceleration_weight,
        )
        model = model if term in {'level', 'cameras'} else replace(model, provenance={})
    if term not in {'all', 'image'}:
        weight *= 1e-300 * (np.arange(FRAMES) == 0)[:, None]
        config, rotation = replace(config, bone_weight=0.0), rotation_from_vector(rng.normal(size=(FRAMES, 3)))
    batch = Batch.build(
        [Window(points, weight, times)], np.array([200.0]), [InitialValues(np.zeros((FRAMES, 1)), cameras)]
    )
    coefficients = 0.05 * rng.normal(size=(2 * HARMONICS + 1, COMPONENTS + 1))
    log_scale = np.log(cameras.scale / 200) + 0.05 * rng.normal(size=FRAMES)
    translation = np.zeros((FRAMES, 2)) if term in {'all', 'image'} else rng.normal(size=(FRAMES, 2))
    values = Point(coefficients, 2 * np.pi * 0.95, rotation, log_scale, translation)
    return Case(batch, model, config, values, times - times.mean())


@pytest.fixture
def case(walk_model: PoseModel, rng: np.random.Generator) -> Case:
    return make_case(walk_model, rng, 'all')


def move(values: Point, step: np.ndarray) -> Point:
    coefficients, omega, rotation, log_scale, translation = values
    series, cameras = step[: SERIES_UNKNOWNS - 1], step[SERIES_UNKNOWNS:].reshape(FRAMES, CAMERA_UNKNOWNS)
    turned = rotation_from_vector(cameras[:, :3]) @ rotation
    moved = coefficients + series.reshape(coefficients.shape), omega + step[SERIES_UNKNOWNS - 1]
    return Point(*moved, turned, log_scale + cameras[:, 3], translation)


def differentiate(values: Point, function: Callable[[Point], np.ndarray | float]) -> np.ndarray:
    """Return central differences of a function of the values by all unknowns, one in each row."""
    rows = []
    for step in STEP * np.eye(SERIES_UNKNOWNS + FRAMES * CAMERA_UNKNOWNS):
        up, down = (np.asarray(function(move(values, s))) for s in (step, -step))
        rows.append((up - down).ravel() / (2 * STEP))
    return np.array(rows)


def begin(case: Case) -> PeriodicProblem:
    problem = case.measure()
    problem.begin(0.0)
    return problem


def read_gradient(problem: PeriodicProblem) -> np.ndarray:
    return np.concatenate([problem.series_gradient, problem.camera_gradient.ravel()])


def dense_matrices(equations: PeriodicProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
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


def make_terms(omega: float, times: np.ndarray) -> np.ndarray:
    angles = [h * omega * times for h in range(1, HARMONICS + 1)]
    return np.stack([np.ones_like(times), *(f(a) for a in angles for f in (np.cos, np.sin))], axis=1)


def test_series_are_those_of_the_least_squares_with_a_ridge(rng: np.random.Generator) -> None:
    times, theta, frequencies = np.sort(rng.uniform(-1, 1, 30)), rng.normal(size=(30, 3)), np.array([3.0, 5.0])
    ridge = rng.uniform(1, 2, 2 * HARMONICS + 1)
    fits, explained = fit_series(times, theta, frequencies, ridge)
    for fit, value, omega in zip(fits, explained, frequencies, strict=True):
        stacked = np.concatenate([make_terms(omega, times), np.diag(np.sqrt(ridge))])
        right = np.concatenate([theta, np.zeros((len(ridge), 3))])
        expected, misfit, *_ = np.linalg.lstsq(stacked, right)
        assert fit == pytest.approx(expected, rel=1e-9)
        assert value == pytest.approx((theta**2).sum() - misfit.sum())


@pytest.mark.parametrize('term', ['image', 'prior', 'movement', 'level'])
def test_gradient_is_half_that_of_the_cost(walk_model: PoseModel, rng: np.random.Generator, term: str) -> None:
    case = make_case(walk_model, rng, term)
    numeric = differentiate(case.values, lambda values: case.measure(values).cost)[:, 0] / 2
    assert np.abs(numeric).max() > 0
    assert np.abs(read_gradient(begin(case)) - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_matrix_of_the_cameras_is_that_of_the_squares(walk_model: PoseModel, rng: np.random.Generator) -> None:
    case = make_case(walk_model, rng, 'cameras')
    problem = begin(case)

    def residuals(values: Point) -> np.ndarray:
        state = State(np.zeros((FRAMES, 0)), values.rotation, values.log_scale, values.translation)
        return compute_residuals(case.batch, case.model, problem.cameras.terms, state)

    bones = case.measure().body.cost  # lengths that differ do not count here
    assert problem.cost - bones == pytest.approx((residuals(case.values) ** 2).sum())
    jacobian = differentiate(case.values, residuals)[SERIES_UNKNOWNS:]
    expected = jacobian @ jacobian.T
    assert dense_matrices(problem)[3] == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize('damping', [0.0, 0.3])
def test_step_solves_the_equations_of_all_unknowns(case: Case, damping: float) -> None:
    problem = begin(case)
    series, mixed, cameras, _ = dense_matrices(problem)
    matrix = np.block([[series, mixed], [mixed.T, cameras]])
    matrix += damping * np.diag(np.diag(matrix)) + MIN_INFORMATION * np.eye(len(matrix))
    expected = -np.linalg.solve(matrix, read_gradient(problem))
    assert problem.solve(damping)
    found = np.concatenate([problem.series_step, problem.camera_step.ravel()])
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-6 * np.abs(expected).max())


def test_a_step_that_is_taken_moves_all_unknowns(case: Case) -> None:
    problem = case.measure()
    problem.begin(10.0)
    values, before = case.measure().point, problem.cost.copy()
    assert problem.try_steps(0.0) == (1, 1)
    step = np.concatenate([problem.series_step, problem.camera_step.ravel()])
    expected = case.measure(move(values, step))
    assert problem.cost < before
    assert problem.cost == pytest.approx(expected.cost, rel=1e-12)
    found, wanted = (np.concatenate([np.ravel(v) for v in p.point]) for p in (problem, expected))
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_counts_and_determinants_are_those_of_the_dense_matrices(case: Case) -> None:
    problem = begin(case)
    series, _, cameras, prior = dense_matrices(problem)
    small = np.eye(CAMERA_UNKNOWNS) * MIN_INFORMATION
    blocks = cameras.reshape(FRAMES, CAMERA_UNKNOWNS, FRAMES, CAMERA_UNKNOWNS)
    expected = SERIES_UNKNOWNS - np.trace(np.linalg.solve(series, np.diag(problem.series_prior)))
    for t in range(FRAMES):
        expected += np.trace(np.linalg.solve(blocks[t, :, t] + small, problem.camera_image[t])) + 2
    assert problem.count_effective_parameters() == pytest.approx(expected, rel=1e-6)
    both = [np.linalg.slogdet(m + MIN_CAMERA_INFORMATION * np.eye(len(m)))[1] for m in (cameras, prior)]
    assert problem.camera_log_determinant_ratio() == pytest.approx(both[0] - both[1], rel=1e-6)


def test_equations_that_are_not_positive_definite_have_no_step(case: Case) -> None:
    problem = begin(case)
    problem.camera_image[-1] *= -1
    assert not problem.solve(0.0)
    assert problem.camera_log_determinant_ratio() == np.inf


def test_equations_of_the_body_follow_by_the_chain_rule(walk_model: PoseModel, rng: np.random.Generator) -> None:
    case, k, cameras = make_case(walk_model, rng, 'image'), COMPONENTS, slice(COMPONENTS, COMPONENTS + 4)
    equations = begin(case)
    body = equations.body

    def evaluate(values: Point) -> np.ndarray:
        return make_terms(values[1], case.times) @ values[0]

    # d (theta, psi) / d x, and d (theta, v, log s) / d (x, w, log s) of every frame
    series = differentiate(case.values, evaluate)[:SERIES_UNKNOWNS].reshape(-1, FRAMES, k + 1)
    to_body = np.tile(np.eye(k + 4, k + 1), (FRAMES, 1, 1))
    to_body[:, k : k + 3, k], to_body[:, k + 3, k] = case.values[2][:, :, 2], 0
    to_series = to_body @ np.moveaxis(series, 0, -1)
    chain = np.concatenate([to_series, np.tile(np.eye(k + 4)[:, cameras], (FRAMES, 1, 1))], axis=2)
    upper = np.triu(body.diagonal)
    blocks = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
    matrices = np.swapaxes(chain, 1, 2) @ blocks @ chain
    gradients = np.einsum('tia,ti->ta', chain, body.gradient)
    bones = np.einsum('tia,tib->ab', chain, body.bone_vectors)[:SERIES_UNKNOWNS]
    x, z = slice(0, SERIES_UNKNOWNS), slice(SERIES_UNKNOWNS, None)
    expected = matrices[:, x, x].sum(axis=0) - bones @ bones.T / FRAMES
    assert equations.series_matrix == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())
    assert equations.series_gradient == pytest.approx(gradients[:, x].sum(axis=0), abs=1e-8)
    assert equations.mixed_matrix == pytest.approx(matrices[:, z, x], abs=1e-8 * np.abs(matrices).max())
    assert equations.camera_image == pytest.approx(matrices[:, z, z], rel=1e-12)
    assert equations.camera_gradient == pytest.approx(gradients[:, z], rel=1e-12)


CADENCE = 0.9  # Hz


@pytest.mark.parametrize(('missing', 'measured_mm'), [(0.0, 24.6), (0.2, 27.1)])
def test_finds_cadence_and_motion(walk_model: PoseModel, missing: float, measured_mm: float) -> None:
    """Of a walk with irregular times, whose four weights have two harmonics each."""
    rng, theta = np.random.default_rng(0), np.zeros((70, len(walk_model.std)))
    times = np.cumsum(rng.uniform(0.02, 0.05, 70))
    angle, phase = 2 * np.pi * CADENCE * times[:, None], rng.uniform(0, 6, (2, 4))
    theta[:, :4] = walk_model.std[:4] * (np.sin(angle + phase[0]) + 0.4 * np.sin(2 * angle + phase[1]))
    rotation = np.tile(BODY_TO_OPTICAL @ rotation_from_vector(np.array([0, 0, 0.9])), (70, 1, 1))
    cameras = WeakPerspectiveCameras(np.full(70, 200.0), rotation)
    walk = Walk(theta, cameras, cameras.project(walk_model.poses(theta)) + [320.0, 240.0], times)
    weight = (np.random.default_rng(2).random((70, 15)) >= missing).astype(float)
    if missing:
        weight[:, [3, 4]] = 0
    result = periodic.solve(replace(walk.window, weight=weight), walk_model, SolverConfig(components=10))
    assert result.cadence == pytest.approx(CADENCE, rel=0.01)
    assert mpjpe_mm(result.joints, walk.poses(walk_model)) < 1.1 * measured_mm
    assert (np.diff(result.history) <= 0).all()


def swing(times: np.ndarray, cadence: float = CADENCE) -> np.ndarray:
    phase = 2 * np.pi * cadence * times[:, None]
    return np.concatenate([np.sin(phase), 0.5 * np.cos(phase), 0.3 * np.sin(2 * phase + 1)], axis=1)


@pytest.mark.parametrize('wrong', [1 - 0.9 * MAX_STRETCH, 1.0, 1 + 0.9 * MAX_STRETCH])
def test_a_periodic_motion_repeats_itself_also_at_a_wrong_cadence(rng: np.random.Generator, wrong: float) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.05, 60))
    assert measure_repetition(times, swing(times), wrong * CADENCE) > 0.97
    noisy = swing(times) + rng.normal(0, 0.1, (60, 3))
    assert 0.8 < measure_repetition(times, noisy, CADENCE) < 1
    noise = rng.normal(size=(120, 60))  # of which interpolation between the samples takes out some
    assert measure_repetition(np.arange(120) / 60, noise, CADENCE) == pytest.approx(0.25, abs=0.1)


@pytest.mark.parametrize('other', ['still', 'elsewhere', 'faster'])
def test_another_motion_after_a_seam_does_not_repeat_the_walk(other: str) -> None:
    times, seam_s = np.arange(66) / 30, 66 / 30 - 2 * REPEATED_S
    theta, after = swing(times), times > seam_s
    theta[after] = {
        'still': np.tile(swing(np.array([seam_s]))[0], (after.sum(), 1)),
        'elsewhere': swing(times[after]) + [2.0, 0, 0],
        'faster': -swing(times[after], 1.9),
    }[other]
    assert measure_repetition(times, theta, CADENCE) < 0.5


def test_what_is_too_short_or_does_not_move_is_not_known() -> None:
    times = np.arange(60) / 30
    assert math.isnan(measure_repetition(times, swing(times), 0.6))
    assert math.isnan(measure_repetition(times[-5:], swing(times[-5:]), CADENCE))
    assert math.isnan(measure_repetition(times, np.ones((60, 3)), CADENCE))


@pytest.mark.parametrize('cadence', [0.55, 0.65, 0.9, 1.4, 2.1])
@pytest.mark.parametrize('rate', [12.0, 30.0, 100.0])
def test_the_best_repetition_needs_no_cadence(rng: np.random.Generator, cadence: float, rate: float) -> None:
    times = np.arange(0, 2.2, 1 / rate)
    assert measure_best_repetition(times, swing(times, cadence)) > 0.9
    drift = np.cumsum(1 + rng.normal(size=(len(times), 3)), axis=0)
    assert measure_best_repetition(times, drift) < 0.2
    assert measure_best_repetition(times, swing(times)) >= measure_repetition(times, swing(times), 1.0) - 0.01


QUICK = SolverConfig(components=20, max_iterations=30)


def fit_periodic(
    window: Window, model: PoseModel, initial: EstimatedPoses | None = None, category: str = 'walk'
) -> PeriodicFit:
    return run_to_end(fit_periodic_stepwise(window, category, model, QUICK, initial))


@pytest.fixture(scope='module')
def fits(walk_model: PoseModel) -> dict[str, PeriodicFit]:
    """A walk, as the periodic model of either category finds it."""
    window = make_walk(walk_model).window
    return {name: fit_periodic(window, walk_model, category=name) for name in ('walk', 'run')}


@pytest.mark.parametrize('category', ['walk', 'run'])
@pytest.mark.parametrize('threshold', ['residual', 'amplitude', 'cadence'])
def test_hysteresis_moves_every_threshold(fits: dict[str, PeriodicFit], category: str, threshold: str) -> None:
    fit, other = fits[category], 'run' if category == 'walk' else 'walk'
    limits: dict[str, Any] = {f'{category}_residual': 1.0, 'amplitude': 0.0, f'{category}_cadence': 0.0}
    limits |= {f'{other}_residual': 0.0, f'{other}_cadence': 5.0, 'hysteresis': 1.1}
    values = {'residual': fit.excess_residual, 'amplitude': fit.amplitude, 'cadence': fit.reconstruction.cadence}
    name, value = threshold if threshold == 'amplitude' else f'{category}_{threshold}', values[threshold]
    cases = (1.15, True, False), (1.05, True, True), (0.95, False, False), (0.87, False, True)
    for share, was_periodic, expected in cases:
        limits[name] = value / share if threshold == 'residual' else value * share
        assert is_periodic(fit, ClassifierConfig(**limits), was_periodic=was_periodic) is expected


def test_a_walk_is_periodic_whatever_the_detector_adds_to_all_frames_alike(walk_model: PoseModel) -> None:
    walk = make_walk(walk_model, 60)
    offset = 12 * np.random.default_rng(3).normal(size=(1, 15, 2))  # px, 5 cm at the body, constant in each joint
    estimated = EstimatedPoses(walk.poses(walk_model), walk.cameras.scale, 0.01)
    window = replace(walk.window, points=walk.points + offset)
    by_residual = fit_periodic(window, walk_model)
    by_movement = fit_periodic(window, walk_model, estimated)
    assert not is_periodic(by_residual, ClassifierConfig(hysteresis=1.0), was_periodic=False)
    assert is_periodic(by_movement, ClassifierConfig(hysteresis=1.0), was_periodic=False)
    assert by_movement.excess_residual < 0.5 * by_residual.excess_residual


def test_what_a_periodic_motion_does_not_explain_counts(walk_model: PoseModel) -> None:
    walk, estimates = make_walk(walk_model, 60), []
    for added in (0.0, 1.0):  # m, of a movement that is no cycle of the walk
        moved = walk._replace(theta=walk.theta.copy())
        moved.theta[:, 1] += added * np.sin(walk.times**2 * 4)
        window = replace(walk.window, points=walk.cameras.project(walk_model.poses(moved.theta)))
        fit = fit_periodic(window, walk_model, EstimatedPoses(moved.poses(walk_model), walk.cameras.scale, 0.01))
        estimates.append(fit.excess_residual)
    assert estimates[0] < 0.005
    assert estimates[1] > 2 * ClassifierConfig().walk_residual


def test_what_jitters_does_not_rule_out_a_periodic_motion(walk_model: PoseModel, rng: np.random.Generator) -> None:
    window = make_walk(walk_model).window
    exact = fit_periodic(window, walk_model).reconstruction
    jittering = exact.joints + rng.normal(0, 0.02, exact.joints.shape)
    poses = [EstimatedPoses(jittering, exact.cameras.scale, 0.01, jitter) for jitter in (0.0, 0.01)]
    excess = [fit_periodic(window, walk_model, p).excess_residual for p in poses]
    assert excess[0] ** 2 - excess[1] ** 2 == pytest.approx(3 * (0.01 / walk_model.stature) ** 2, rel=0.05)


@pytest.mark.parametrize('rate', [30.0, 100.0])
def test_jitter_is_what_remains_of_noise_without_the_motion(rng: np.random.Generator, rate: float) -> None:
    times = np.arange(int(2 * rate)) / rate
    swing = 0.2 * np.sin(2 * np.pi * times[:, None, None] + rng.uniform(0, 6, (15, 2)))
    assert measure_jitter(times, swing) < 0.003, 'm; the motion of 0.2 m'
    noise = rng.normal(0, 0.02, swing.shape)
    noise -= noise.mean(axis=1, keepdims=True)
    assert measure_jitter(times, swing + noise) == pytest.approx(0.02 * np.sqrt(2), rel=0.15)
    moved = swing + noise + np.cumsum(rng.normal(0, 1, (len(times), 1, 2)), axis=0)
    assert measure_jitter(times, moved) == pytest.approx(measure_jitter(times, swing + noise)), 'of the body'
    few_frames, slow = slice(5), slice(0, None, int(rate / 10))
    assert measure_jitter(times[few_frames], noise[few_frames]) == measure_jitter(times[slow], noise[slow]) == 0


MOTION_FRAMES = 30
TIMES = np.arange(MOTION_FRAMES) / 30
UNKNOWN = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scenes are orthographic


def make_motion(name: str, times: Array = TIMES) -> tuple[Array, PoseModel, Array]:
    """Return poses (F, 15, 3) m of a motion of the demo in the camera's axes, its base poses and keypoints."""
    model, motions = load_motions()
    poses, own = (model.poses(motions[name].sample(t)[:, :-2]) for t in (times, TIMES))
    base_poses = fit_base_poses([own], name='own', alignment='heading')
    truth = poses @ (BODY_TO_OPTICAL @ rotation_from_vector(np.array([0.0, 0.0, 0.8]))).T
    return truth, base_poses, 200 * truth[..., :2] + [320, 240]


def reconstruct(points: Array, base_poses: PoseModel, prior: str = 'learned') -> Array:
    config = Config(solver=SolverConfig(prior=prior))
    return reconstruct_sequence(make_sequence(with_scores(points), TIMES, UNKNOWN), base_poses, config).core


@pytest.mark.parametrize('lifter_noise', [0.0, 0.001, 0.01, 0.02, 2 * MAX_NOISE])
def test_a_little_more_noise_is_allowed_but_not_any(lifter_noise: float) -> None:
    total = MAX_NOISE_RATIO * np.hypot(lifter_noise, NEGLIGIBLE_NOISE)
    limit = min(np.sqrt(total**2 - NEGLIGIBLE_NOISE**2), MAX_NOISE)
    assert explains_as_well(0.999 * limit, lifter_noise)
    assert not explains_as_well(1.001 * limit, lifter_noise)
    assert explains_as_well(1.001 * limit, lifter_noise, slack=1.1)


def test_base_poses_of_the_very_person_lead(monkeypatch: pytest.MonkeyPatch) -> None:
    truth, base_poses, points = make_motion('run')
    own, alone = (reconstruct(points, base_poses, prior) for prior in ('learned', 'pca'))
    of_all = reconstruct(points, replace(base_poses, name='all'))
    monkeypatch.setattr(whole_sequence, 'explains_as_well', lambda *_: False)
    lifter_leads = reconstruct(points, base_poses)
    assert mpjpe_mm(own, truth) < 1.1 * mpjpe_mm(alone, truth)
    assert mpjpe_mm(own, truth) < 0.6 * mpjpe_mm(lifter_leads, truth)
    np.testing.assert_array_equal(of_all, lifter_leads, 'base poses of that name are those of all motions')


def test_live_the_lead_is_taken_and_given_back() -> None:
    """Base poses of a run lead soon after the run has begun, and no longer when a walk has taken its place."""
    times = np.arange(2 * MOTION_FRAMES) / 30
    _, base_poses, run = make_motion('run', times)
    _, _, walk = make_motion('walk', times)
    trackers = [PeopleTracker(m, Config()) for m in (base_poses, replace(base_poses, name='all'))]
    leads: list[list[bool]] = [[], []]
    for frame, points in enumerate([*run, *walk]):
        for tracker, lead in zip(trackers, leads, strict=True):
            feed(tracker, points[None], frame * STEP_NS, UNKNOWN)
            tracker.run_deferred_work()
            lead.append(tracker.tracks[0].solved.base_poses_lead)
    own, of_all = leads
    assert not own[0], 'a first solution needs the lifter, for a frame does not tell front from back'
    assert all(own[45 : 2 * MOTION_FRAMES])
    assert not any(own[3 * MOTION_FRAMES + 15 :])
    assert not any(of_all)
