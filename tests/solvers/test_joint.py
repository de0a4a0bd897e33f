# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The joint solver against NumPy, finite differences and the alternation; a batch that equals its parts."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy import linalg, signal
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.engine.joint import JointProblem
from mocap_ros.engine.terms import MAX_NOISE_RATIO, Acceleration, Level, Term
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.joint.activity import ACTIVITY_SPAN_S, measure_activity
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.joint.lifted_start import fit_lifted_poses
from mocap_ros.solvers.joint.objective import choose_weights, list_terms, pose_problem, read_state, set_noise
from mocap_ros.solvers.leading_prior import let_base_poses_lead
from mocap_ros.solvers.window import Reconstruction, Window, initialise_from_mean_pose, reverse_depth
from tests.support.plain_objective import TWINS, advance, compute_cost, compute_residuals
from tests.support.synthetic_walk import make_walk

COMPONENTS, FRAMES = 6, (7, 5)
UNKNOWNS = COMPONENTS + 4
NOISE = np.array([0.005, 0.02])
CONFIG = SolverConfig(
    prior_weight=1e-2,
    smooth_weight=1e-3,
    flip_weight=0.5,
    tilt_weight=0.3,
    scale_weight=0.2,
    lifter_weight=0.1,
    pose_acceleration_weight=1e-4,
    camera_acceleration_weight=1e-3,
    robust_scale=0.03,
)


class Case(NamedTuple):
    """An objective, and a state with optimal translations."""

    batch: Batch
    model: PoseModel
    terms: tuple[Term, ...]
    state: State

    def linearise(self, terms: tuple[Term, ...] | None = None) -> JointProblem:
        problem = pose_problem(self.batch, self.model, terms or self.terms)
        problem.start(*self.state)
        problem.begin(0.1)
        return problem


def make_case(
    walk_model: PoseModel,
    rng: np.random.Generator,
    config: SolverConfig = CONFIG,
    focal: float = 300.0,
    lifted: bool = True,
) -> Case:
    """Two sequences with missing points and frames before the first."""
    model, windows = walk_model.truncate(COMPONENTS), []
    for frames in FRAMES:
        theta, _, points, times = make_walk(walk_model, frames=frames, seed=frames)
        weight = rng.uniform(0.3, 1, points.shape[:2]) * (rng.random(points.shape[:2]) > 0.1)
        poses = 200 * walk_model.poses(theta) + 30 * rng.normal(size=(*points.shape[:2], 3))
        poses[1] = np.nan
        window = Window(points, weight, times + rng.uniform(0, 0.01, frames), focal=focal)
        if lifted:
            window = replace(window, lifted=LiftedPoses(poses, rng.uniform(5, 50, poses.shape)))
        windows.append(window)
    starts = [initialise_from_mean_pose(w, model, 1.0) for w in windows]
    units = np.array([np.median(s.cameras.scale) for s in starts])
    batch = Batch.build(windows, units, starts)
    batch.sequences['earlier_lengths'][0] = 1.1 * model.skeleton.bone_lengths(model.mean)
    batch.sequences['earlier_frames'][0] = 4
    set_noise(batch, NOISE)
    activity = rng.uniform(0, 300, sum(FRAMES)), rng.uniform(0, 30, sum(FRAMES))
    terms = list_terms(batch, model, config, activity=activity)
    problem = pose_problem(batch, model, terms)
    problem.start(*advance(batch.start, 0.05 * rng.normal(size=(sum(FRAMES), UNKNOWNS))), settle_steps=100)
    return Case(batch, model, terms, read_state(problem))


def test_every_term_has_a_twin_and_a_case(walk_model: PoseModel, rng: np.random.Generator) -> None:
    assert {*map(type, make_case(walk_model, rng).terms)} == {*TWINS} - {Level}, 'Level is of the periodic solver'


@pytest.mark.parametrize('robust', [0.0, 0.03])
@pytest.mark.parametrize('focal', [math.inf, 300.0])
@pytest.mark.parametrize('kind', TWINS)
def test_cost_and_gradient_of_each_term_are_those_of_its_twin(
    walk_model: PoseModel, rng: np.random.Generator, kind: type[Term], robust: float, focal: float
) -> None:
    case = make_case(walk_model, rng, replace(CONFIG, robust_scale=robust), focal)
    for term in (*case.terms, Level(0.3)):
        if type(term) is not kind:
            continue
        problem, cost = case.linearise((term,)), compute_cost(case.batch, case.model, term, case.state)
        assert cost > 0
        assert problem.cost.sum() == pytest.approx(cost, rel=1e-9)
        numeric, h = np.empty_like(problem.gradient), 1e-5
        for index in np.ndindex(*numeric.shape):
            step = np.zeros_like(numeric)
            step[index] = h
            states = advance(case.state, step), advance(case.state, -step)
            up, down = (compute_cost(case.batch, case.model, term, state) for state in states)
            numeric[index] = (up - down) / (2 * h) / 2
        assert np.abs(problem.gradient - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_the_objective_is_the_sum_of_its_terms(walk_model: PoseModel, rng: np.random.Generator) -> None:
    case = make_case(walk_model, rng)
    alone = [case.linearise((term,)) for term in case.terms]
    together = case.linearise()
    assert together.cost == pytest.approx(sum(problem.cost for problem in alone))
    np.testing.assert_allclose(together.gradient, sum(problem.gradient for problem in alone), atol=1e-12)


def make_dense(problem: JointProblem, batch: Batch) -> np.ndarray:
    frames, n = problem.gradient.shape
    matrix = np.zeros((frames, n, frames, n))
    for t in range(frames):
        matrix[t, :, t] = np.triu(problem.diagonal[t]) + np.triu(problem.diagonal[t], 1).T
    for distance in range(1, problem.coupling.shape[1] + 1):
        for t in range(frames - distance):
            of_weights, of_cameras = np.split(problem.coupling[t, distance - 1], [n - 4])
            block = linalg.block_diag(np.diag(of_weights), of_cameras.reshape(4, 4))
            matrix[t, :, t + distance], matrix[t + distance, :, t] = block, block.T
    counts = batch.sequences['count'] + batch.sequences['earlier_frames']
    for own, count in zip(batch.slices, counts, strict=True):
        g = problem.bone_vectors[own]
        matrix[own, :, own] -= np.einsum('tib,ujb->tiuj', g, g) / count
    return matrix.reshape(frames * n, frames * n)


@pytest.mark.parametrize('focal', [math.inf, 300.0])
@pytest.mark.parametrize('bone_weight', [60.0, 0.0])
def test_normal_matrix_is_that_of_residuals(
    walk_model: PoseModel, rng: np.random.Generator, focal: float, bone_weight: float
) -> None:
    """J^T J with J by finite differences of every residual, translations eliminated.

    What the matrix holds beyond it, the curvature of bones, is positive semidefinite.
    """
    config = replace(CONFIG, robust_scale=0.0, bone_weight=bone_weight)
    case = make_case(walk_model, rng, config, focal, lifted=False)
    frames, n, jac = sum(FRAMES), UNKNOWNS, []
    for step in 1e-6 * np.eye(frames * (n + 2)).reshape(-1, frames, n + 2):
        ends = []
        for s in (step, -step):
            moved = advance(case.state, s[:, :n])
            moved = moved._replace(translation=moved.translation + s[:, n:])
            ends.append(compute_residuals(case.batch, case.model, case.terms, moved))
        jac.append((ends[0] - ends[1]) / 2e-6)
    of_translation = np.arange(frames * (n + 2)) % (n + 2) >= n
    rest, translation = np.array(jac)[~of_translation], np.array(jac)[of_translation]
    rest -= rest @ np.linalg.pinv(translation) @ translation
    expected = rest @ rest.T
    excess = make_dense(case.linearise(), case.batch) - expected
    assert np.linalg.eigvalsh(excess).min() > -1e-6 * np.abs(expected).max()
    if not bone_weight:
        assert np.abs(excess).max() < 1e-6 * np.abs(expected).max()


def test_a_step_solves_the_damped_equations(walk_model: PoseModel, rng: np.random.Generator) -> None:
    """Frames that are held do not move."""
    case = make_case(walk_model, rng)
    case.batch.frames['is_free'][[0, 1, FRAMES[0]]] = 0
    problem = case.linearise()
    matrix = make_dense(problem, case.batch)
    matrix += 0.1 * np.diag(np.concatenate([np.diag(d) for d in problem.diagonal]))
    free = np.repeat(case.batch.frames['is_free'] > 0, UNKNOWNS)
    step = np.zeros(len(matrix))
    step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], problem.gradient.ravel()[free])
    moved = advance(case.state, step.reshape(-1, UNKNOWNS))
    assert problem.try_steps(0.0) == (2, 2)
    found = read_state(problem)
    for name in ('theta', 'rotation', 'log_scale'):
        np.testing.assert_allclose(getattr(found, name), getattr(moved, name), atol=1e-9)


def test_the_limit_of_accelerations_gives_way_to_fast_motion_and_holds_under_noise(
    walk_model: PoseModel, rng: np.random.Generator
) -> None:
    case, weight = make_case(walk_model, rng), np.full(COMPONENTS + 13, 2.0)
    for noise_ratio, limit in ((1.0, 3.0), (0.5, 3.0), (1.25, 3.75), (20.0, 3 * MAX_NOISE_RATIO)):
        case.batch.sequences['noise_ratio'] = noise_ratio
        for acceleration in (0.0, 3.0, 9.0):
            squares = np.full(sum(FRAMES), acceleration**2)
            costs = [case.linearise((Acceleration(weight, 3.0, a),)).cost for a in (squares, None)]
            assert costs[0] / costs[1] == pytest.approx(1 / (1 + (acceleration / limit) ** 4), rel=1e-12)


def make_batch(
    walk_model: PoseModel, times: list[Array], image: Array | None = None, lifted: bool = False
) -> Batch:
    windows, first = [], 0
    for t in times:
        points = (
            np.random.default_rng(0).normal(size=(len(t), 15, 2)) if image is None else image[first:][: len(t)]
        )
        poses = LiftedPoses(np.zeros((len(t), 15, 3)), np.ones((len(t), 15, 3))) if lifted else None
        windows.append(Window(points, np.ones((len(t), 15)), t, lifted=poses))
        first += len(t)
    starts = [initialise_from_mean_pose(w, walk_model, 1.0) for w in windows]
    return Batch.build(windows, np.ones(len(times)), starts)


@pytest.mark.parametrize(('rate_hz', 'is_known'), [(30.0, True), (60.0, True), (15.0, False)])
def test_the_least_noise_is_that_of_white_and_of_wandering_errors(
    walk_model: PoseModel, rng: np.random.Generator, rate_hz: float, is_known: bool
) -> None:
    """Points at rest, some of which jump, with white noise of 5 mm and errors of 13 mm that decay in 0.3 s."""
    times, white, kept = np.arange(300) / rate_hz, rng.standard_normal((300, 15, 2)), math.exp(-1 / rate_hz / 0.3)

    def measure(image: Array) -> Array:
        return make_batch(walk_model, [times], image, lifted=True).sequences['least_noise']

    jumps = np.where(rng.random((300, 15)) < 0.002, 0.3, 0.0)[..., None]
    wandering = signal.lfilter([math.sqrt(1 - kept**2)], [1, -kept], white, axis=0)
    for errors, noise in ((0.005 * white, 0.005), (0.013 * wandering, 0.013)):
        assert measure(errors + jumps) == pytest.approx([noise * is_known], rel=0.3)
    assert measure(np.tile(0.1 * np.sin(4 * times)[:, None, None], (1, 15, 2))) == pytest.approx([0.0])


def test_activity_is_the_mean_square_acceleration_nearby(walk_model: PoseModel, rng: np.random.Generator) -> None:
    """Two sequences, one at rest and one with 2 m/s^2 in one of two values from its second second on."""
    times = [np.sort(rng.uniform(0, 4, 40)), np.arange(41) / 10]
    moved = np.where(times[1] < 2, 0.0, (times[1] - 2) ** 2)
    values = np.concatenate([np.ones((40, 2)), np.stack([moved, np.zeros(41)], axis=1)])
    coarse = make_batch(walk_model, times)
    fine = make_batch(walk_model, [np.arange(120) / 30, np.arange(120) / 30])
    found = measure_activity(values, coarse, fine)
    np.testing.assert_allclose(found[:120], 0.0, atol=1e-12)
    later = fine.times[120:] > 2 + ACTIVITY_SPAN_S + 0.11
    earlier = fine.times[120:] < 2 - ACTIVITY_SPAN_S - 0.11
    inner = later & (fine.times[120:] < 4 - ACTIVITY_SPAN_S - 0.11)
    np.testing.assert_allclose(found[120:][inner], 4.0)
    np.testing.assert_allclose(found[120:][earlier], 0.0, atol=1e-12)
    few = make_batch(walk_model, [np.array([0.0, 0.1])])
    np.testing.assert_array_equal(measure_activity(np.ones((2, 3)), few, few), 0.0)


def test_acceleration_is_the_second_derivative_at_any_times(
    walk_model: PoseModel, rng: np.random.Generator
) -> None:
    """Log s is a parabola of time, with an acceleration of 1/s^2."""
    weight = np.append(np.zeros(COMPONENTS + 12), 3.0)
    for times in (np.arange(12) / 10, np.arange(12) / 30, np.cumsum(rng.uniform(0.04, 0.2, 12))):
        batch = make_batch(walk_model.truncate(COMPONENTS), [times])
        problem = pose_problem(batch, walk_model.truncate(COMPONENTS), (Acceleration(weight),))
        problem.start(*batch.start._replace(log_scale=0.5 * times**2 + 2 * times))
        share, middle = batch.sequences['motion_share'][0], (times[2:] - times[:-2]) / 2
        assert problem.cost == pytest.approx([3.0 * share * middle.sum()], rel=1e-6)


WEIGHTS = [
    *(f'{name}_weight' for name in ('prior', 'smooth', 'flip', 'tilt', 'scale', 'bone', 'lifter')),
    *('pose_acceleration_weight', 'camera_acceleration_weight', 'lifter_prior_factor', 'heading_prior_factor'),
    *('lifter_smooth_factor', 'lifter_acceleration_factor', 'lifter_flip_factor', 'heading_flip_factor'),
]


@pytest.mark.parametrize('name', WEIGHTS)
def test_the_cost_is_linear_in_its_weights(walk_model: PoseModel, rng: np.random.Generator, name: str) -> None:
    case = make_case(walk_model, rng)
    model = replace(case.model, provenance={'alignment': 'heading'})

    def compute(value: float) -> float:
        changed: Any = {name: value}
        varied = list_terms(case.batch, model, replace(SolverConfig(), **changed))
        return sum(compute_cost(case.batch, model, term, case.state) for term in varied)

    one, two, three = (compute(value) for value in (0.01, 0.02, 0.03))
    assert three - two == pytest.approx(two - one)
    assert two > one


def test_base_poses_that_lead_have_the_weights_that_they_have_alone(walk_model: PoseModel) -> None:
    config = SolverConfig()
    alone = choose_weights(walk_model, config, has_lifted=False)
    leading = choose_weights(walk_model, let_base_poses_lead(config), has_lifted=True)
    for mine, expected in zip(leading, alone, strict=True):
        np.testing.assert_equal(mine, expected)


PLAIN = SolverConfig(
    components=10,
    prior_weight=3e-4,
    bone_weight=20.0,
    flip_weight=0.005,
    smooth_weight=0.0,
    pose_acceleration_weight=0.0,
    robust_scale=0.0,
    heading_flip_factor=1.0,
    heading_prior_factor=1.0,
    tilt_weight=0.0,
    scale_weight=0.0,
    adapt_noise=False,
)


def make_window(model: PoseModel, frames: int = 30, seed: int = 0, noise: float = 2.0) -> Window:
    """A noisy window with missing points and irregular times."""
    exact, rng = make_walk(model, frames=frames, seed=seed).window, np.random.default_rng(seed)
    weight = rng.uniform(0.3, 1, (frames, 15)) * (rng.random((frames, 15)) > 0.1)
    times = exact.times + rng.uniform(0, 0.01, frames)
    return Window(exact.points + noise * rng.normal(size=exact.points.shape), weight, times)


def test_reaches_the_alternations_minimum_or_a_lower_one(walk_model: PoseModel) -> None:
    config = replace(PLAIN, tolerance=1e-9, max_iterations=3000)
    w = make_window(walk_model)
    w = replace(w, times=1.01 * w.times)  # above 30 Hz the joint solver weighs differences more
    slow = alternation.reconstruct(w, walk_model, config)
    (fast,) = joint.solve([w], walk_model, config)
    assert fast.history[0] == pytest.approx(slow.history[0], rel=1e-9)
    assert fast.cost <= slow.cost * (1 + 1e-3), 'the same or a neighbouring minimum'
    assert np.argmax(np.array(fast.history) <= fast.cost * (1 + 1e-4)) <= 15


@pytest.mark.parametrize('scale', [1e-3, 200.0])
def test_lifted_poses_give_the_start(walk_model: PoseModel, rng: np.random.Generator, scale: float) -> None:
    theta = 0.1 * walk_model.std * rng.normal(size=(30, len(walk_model.std)))
    rotation = Rotation.random(30, random_state=0).as_matrix()
    poses = scale * walk_model.poses(theta) @ np.swapaxes(rotation, -1, -2)
    lifted = LiftedPoses(poses, np.full(poses.shape, 1e-6 * scale))
    found = fit_lifted_poses(lifted, np.arange(30.0), walk_model)
    assert found is not None
    assert found.cameras.scale == pytest.approx(np.full(30, scale), rel=0.01)
    assert found.theta == pytest.approx(theta, abs=0.02)
    assert found.cameras.rotation == pytest.approx(rotation, abs=0.02)


@pytest.mark.parametrize('shape', [np.diag([1.0, 0, 0]), -np.eye(3), np.diag([1.0, 0.5, -0.5])])
def test_lifted_poses_without_a_best_rotation_still_give_one(walk_model: PoseModel, shape: Array) -> None:
    mean = walk_model.mean  # shape is the sum of y Q^T: of joints on a line, and of mirrored poses
    poses = mean @ np.linalg.solve(mean.T @ mean, Rotation.random(5, random_state=0).as_matrix() @ shape)
    lifted = LiftedPoses(poses, np.full(poses.shape, 1e3))  # so uncertain that the pose stays the mean
    found = fit_lifted_poses(lifted, np.arange(5.0), walk_model)
    assert found is not None
    rotation = found.cameras.rotation
    assert rotation @ np.swapaxes(rotation, 1, 2) == pytest.approx(np.tile(np.eye(3), (5, 1, 1)), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(np.ones(5))


def test_a_batch_gives_what_each_sequence_gives_alone(walk_model: PoseModel) -> None:
    config = SolverConfig(smooth_weight=1e-5, robust_scale=0.05, components=10, tolerance=1e-10)
    windows = [make_window(walk_model, frames, seed) for frames, seed in ((20, 1), (9, 2), (14, 3))]
    together = joint.solve(windows, walk_model, config)
    for one, w in zip(together, windows, strict=True):
        (alone,) = joint.solve([w], walk_model, config)
        assert one.joints == pytest.approx(alone.joints, abs=1e-7)
        assert one.iterations == alone.iterations


def test_the_necker_reversal_mends_a_camera_that_is_reversed(walk_model: PoseModel) -> None:
    clean = make_window(walk_model, noise=0.5)
    start = initialise_from_mean_pose(clean, walk_model.truncate(10), 1.0)
    (right,) = joint.solve([clean], walk_model, SolverConfig(components=10))
    unit = float(np.median(start.cameras.scale))
    misled = replace(clean, start=reverse_depth(start), unit=unit)
    (one,) = joint.solve_hypotheses([misled], walk_model, SolverConfig(components=10, heading_hypotheses=1))
    (best,) = joint.solve_hypotheses([misled], walk_model, SolverConfig(components=10, heading_hypotheses=2))

    def apart(result: Reconstruction) -> float:
        return float(np.linalg.norm(result.joints - right.joints, axis=-1).mean())

    assert apart(one) > 0.05
    assert apart(best) < 0.01


def test_noise_is_found(walk_model: PoseModel) -> None:
    exact, rng = make_walk(walk_model, frames=60).window, np.random.default_rng(5)
    for px in (1.0, 4.0):
        noisy = replace(exact, points=exact.points + px * rng.normal(size=exact.points.shape))
        (result,) = joint.solve([noisy], walk_model, SolverConfig())
        assert result.noise == pytest.approx(px / 205, rel=0.2)


@pytest.mark.parametrize('hidden', [slice(0), slice(140, 320)])
def test_a_sequence_in_sections_is_as_in_one(
    walk_model: PoseModel, rng: np.random.Generator, hidden: slice
) -> None:
    """Three sections, also where nobody is seen in all of the middle one."""
    walk, reported = make_walk(walk_model, frames=450), list[float]()
    weight = np.ones(walk.points.shape[:2])
    weight[hidden] = 0
    window = Window(walk.points + rng.normal(0, 1.0, walk.points.shape), weight, walk.times)
    config = SolverConfig(components=COMPONENTS)
    whole = joint.solve_in_sections(window, walk_model, config)
    parts = joint.solve_in_sections(window, walk_model, config, reported.append, max_frames=150)
    difference = np.linalg.norm(parts.joints - whole.joints, axis=-1)[weight > 0]
    assert difference.mean() < 1.8e-3, 'the tolerance of the solver alone makes 0.5 mm'
    assert parts.noise == pytest.approx(whole.noise, rel=0.05)
    assert np.isnan(parts.residual).tolist() == np.isnan(whole.residual).tolist()
    assert reported == sorted(reported)
    assert reported[-1] == 1
