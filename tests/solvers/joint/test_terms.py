# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every term of the joint objective alone: its gradient is that of its cost, its matrix that of its squares."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.joint.base_pose_prior import BasePosePrior
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.bone_lengths import BoneLengths
from mocap_ros.solvers.joint.camera_acceleration import CameraAcceleration
from mocap_ros.solvers.joint.camera_smoothness import CameraSmoothness
from mocap_ros.solvers.joint.lifted_pose import LiftedPoseTerm
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.pose_acceleration import PoseAcceleration
from mocap_ros.solvers.joint.pose_smoothness import PoseSmoothness
from mocap_ros.solvers.joint.reprojection import Reprojection
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.joint.term import Term
from mocap_ros.solvers.window import EarlierFrames, Window, initialise_from_mean_pose
from tests.support.dense_matrices import make_dense_coupling
from tests.support.synthetic_walk import make_walk

COMPONENTS = 6
STEP = 1e-5  # of the finite differences: errors of rounding and of the third order are about equal
TERMS = (
    BoneLengths,
    BasePosePrior,
    PoseSmoothness,
    CameraSmoothness,
    PoseAcceleration,
    CameraAcceleration,
    LiftedPoseTerm,
)


@pytest.fixture
def objective_and_state(walk_model: BasePoses, rng: np.random.Generator) -> tuple[JointObjective, State]:
    """Two sequences under perspective, with missing points, lifted poses and frames before the first window."""
    model = walk_model.truncate(COMPONENTS)
    windows = []
    for frames in (7, 5):
        theta, _, points, times = make_walk(walk_model, frames=frames, seed=frames)
        weight = rng.uniform(0.3, 1, points.shape[:2]) * (rng.random(points.shape[:2]) > 0.1)
        poses = 200 * walk_model.poses(theta) + 30 * rng.normal(size=(*points.shape[:2], 3))
        lifted = LiftedPoses(poses, rng.uniform(5, 50, poses.shape))
        lengths = 1.1 * model.skeleton.bone_lengths(model.mean)
        earlier = EarlierFrames(4, lengths) if frames == 7 else None
        windows.append(Window(points, weight, times, focal=300.0, earlier_frames=earlier, lifted=lifted))
    starts = [initialise_from_mean_pose(w, model, 1.0) for w in windows]
    units = np.array([np.median(s.cameras.scale) for s in starts])
    config = SolverConfig(
        prior_weight=1e-2,
        smooth_weight=1e-3,
        flip_weight=0.5,
        tilt_weight=0.3,
        scale_weight=0.2,
        lifter_weight=0.1,
        pose_acceleration_weight=1e-4,
        camera_acceleration_weight=1e-3,
    )
    objective = JointObjective.build(windows, units, model, config)
    state = objective.initial_state(starts, units)
    return objective, state.advanced(0.1 * rng.normal(size=(12, COMPONENTS + CAMERA_UNKNOWNS)))


def empty_equations(objective: JointObjective, state: State) -> NormalEquations:
    return NormalEquations.begin(
        objective.fit(state),
        objective.basis,
        len(objective.bones.weight),
        objective.is_free,
        objective.coupled_frames,
    )


def equations_of(term: Term, objective: JointObjective, state: State) -> NormalEquations:
    """The equations to which one term has added."""
    equations = empty_equations(objective, state)
    term.add_to(equations, objective.fit(state))
    equations.transfer_from_joints()
    return equations


def differentiate(cost: Callable[[State], float], state: State) -> np.ndarray:
    """(N, n) central differences of a function of the state."""
    out = np.empty((len(state.theta), COMPONENTS + CAMERA_UNKNOWNS))
    for index in np.ndindex(*out.shape):
        step = np.zeros_like(out)
        step[index] = STEP
        out[index] = (cost(state.advanced(step)) - cost(state.advanced(-step))) / (2 * STEP)
    return out


@pytest.mark.parametrize('kind', TERMS)
def test_gradient_is_half_that_of_the_cost(
    objective_and_state: tuple[JointObjective, State], kind: type[Term]
) -> None:
    objective, state = objective_and_state
    term = objective.find_term(kind)
    equations = equations_of(term, objective, state)
    numeric = differentiate(lambda s: float(term.cost(objective.fit(s)).sum()), state) / 2
    assert np.abs(numeric).max() > 0
    assert np.abs(equations.gradient - numeric).max() < 1e-6 * np.abs(numeric).max()


UNITS = np.array([200.0])  # px/m, at which `make_lifted_window` shows the walk


def make_lifted_window(walk_model: BasePoses, frames: int) -> Window:
    """Return a walk with lifted poses, which are right and have a standard deviation of 20 px."""
    theta, _, points, times = make_walk(walk_model, frames=frames)
    lifted = LiftedPoses(200 * walk_model.poses(theta), np.full((frames, 15, 3), 20.0))
    return Window(points, np.ones(points.shape[:2]), times, lifted=lifted)


def choose_state(objective: JointObjective, window: Window) -> State:
    """Return random unknowns near the mean pose, the same for each objective of a window."""
    without_poses = replace(window, lifted=None)
    state = objective.initial_state([initialise_from_mean_pose(without_poses, objective.model, 1.0)], UNITS)
    size = len(window.times), len(objective.model.std) + CAMERA_UNKNOWNS
    return state.advanced(0.1 * np.random.default_rng(0).normal(size=size))


WEIGHTS: dict[str, type[Term]] = {
    'prior_weight': BasePosePrior,
    'smooth_weight': PoseSmoothness,
    'flip_weight': CameraSmoothness,
    'tilt_weight': CameraSmoothness,
    'scale_weight': CameraSmoothness,
    'bone_weight': BoneLengths,
    'lifter_weight': LiftedPoseTerm,
    'pose_acceleration_weight': PoseAcceleration,
    'camera_acceleration_weight': CameraAcceleration,
}


@pytest.mark.parametrize('name', WEIGHTS)
def test_terms_have_the_weights_of_the_parameters(walk_model: BasePoses, name: str) -> None:
    model, window = walk_model.truncate(COMPONENTS), make_lifted_window(walk_model, 7)

    def cost(weights: Mapping[str, Any]) -> float:
        objective = JointObjective.build([window], UNITS, model, SolverConfig(**weights))
        fit = objective.fit(choose_state(objective, window))
        return float(objective.find_term(WEIGHTS[name]).cost(fit).sum())

    of_one_class = {other: 0.0 for other, kind in WEIGHTS.items() if kind is WEIGHTS[name]}
    single = cost({**of_one_class, name: 0.01})
    assert single > 0
    assert cost({**of_one_class, name: 0.02}) == pytest.approx(2 * single)


def test_terms_have_the_factors_of_lifted_poses_and_of_heading(walk_model: BasePoses) -> None:
    model = replace(walk_model.truncate(COMPONENTS), provenance={'alignment': 'full'})
    with_poses = make_lifted_window(walk_model, 7)
    alone = replace(with_poses, lifted=None)
    config = SolverConfig(
        scale_weight=0.0,
        tilt_weight=0.0,
        lifter_prior_factor=3.0,
        lifter_smooth_factor=5.0,
        lifter_flip_factor=7.0,
        heading_prior_factor=11.0,
        heading_flip_factor=13.0,
    )

    def costs(window: Window, base_poses: BasePoses) -> list[float]:
        objective = JointObjective.build([window], UNITS, base_poses, config)
        fit = objective.fit(choose_state(objective, window))
        kinds: tuple[type[Term], ...] = (BasePosePrior, PoseSmoothness, CameraSmoothness)
        return [float(objective.find_term(kind).cost(fit).sum()) for kind in kinds]

    plain = np.array(costs(alone, model))
    assert min(plain) > 0
    np.testing.assert_allclose(costs(with_poses, model) / plain, [3, 5, 7])
    by_heading = replace(model, provenance={'alignment': 'heading'})
    np.testing.assert_allclose(costs(alone, by_heading) / plain, [11, 1, 13])
    np.testing.assert_allclose(costs(with_poses, by_heading) / plain, [33, 5, 91])


@pytest.mark.parametrize('robust_scale', [0.1, 2.0, 1e3])
def test_lifted_poses_cost_what_cauchys_loss_says(walk_model: BasePoses, robust_scale: float) -> None:
    window = make_lifted_window(walk_model, 5)
    assert window.lifted is not None
    config = SolverConfig(lifter_weight=0.1, lifter_robust_scale=robust_scale)
    objective = JointObjective.build([window], UNITS, walk_model.truncate(COMPONENTS), config)
    fit = objective.fit(choose_state(objective, window))
    squared = (((200 * fit.scaled_poses - window.lifted.joints) / window.lifted.std) ** 2).sum(axis=-1)
    assert 1 < squared.mean() < 1e3, 'no unit, of a joint; so that the scales make a difference'
    expected = 0.1 * robust_scale**2 * np.log1p(squared / robust_scale**2).sum(axis=1)
    np.testing.assert_allclose(objective.find_term(LiftedPoseTerm).cost(fit), expected)


@pytest.mark.parametrize('kind', [Reprojection, BoneLengths, BasePosePrior, LiftedPoseTerm])
def test_terms_of_single_frames_are_those_of_these_frames_alone(walk_model: BasePoses, kind: type[Term]) -> None:
    model, config = walk_model.truncate(COMPONENTS), SolverConfig()
    earlier = EarlierFrames(4, 1.1 * model.skeleton.bone_lengths(model.mean))
    window = replace(make_lifted_window(walk_model, 12), earlier_frames=earlier)
    assert window.lifted is not None
    objective = JointObjective.build([window], UNITS, model, config)
    state = choose_state(objective, window)
    kept = objective.batch.subsample(0.1, window.weight.sum(axis=1))
    assert 1 < len(kept.frames) < 12
    some = replace(
        window,
        points=window.points[kept.frames],
        weight=window.weight[kept.frames],
        times=window.times[kept.frames],
        lifted=LiftedPoses(window.lifted.joints[kept.frames], window.lifted.std[kept.frames]),
    )
    alone = JointObjective.build([some], UNITS, model, config)
    costs = [o.find_term(kind).cost(o.fit(state.select(kept.frames))) for o in (objective.subsampled(kept), alone)]
    assert costs[0] == pytest.approx(costs[1])
    gradients = [
        equations_of(o.find_term(kind), o, state.select(kept.frames)).gradient
        for o in (objective.subsampled(kept), alone)
    ]
    assert gradients[0] == pytest.approx(gradients[1])
    assert objective.subsampled(kept).bones.strength == pytest.approx(alone.bones.strength)


@pytest.mark.parametrize('kind', [BasePosePrior, PoseSmoothness, PoseAcceleration])
def test_matrix_of_quadratic_terms_is_their_second_derivative(
    objective_and_state: tuple[JointObjective, State], kind: type[Term]
) -> None:
    objective, state = objective_and_state
    term = objective.find_term(kind)

    def gradient(at: State) -> np.ndarray:
        return equations_of(term, objective, at).gradient

    equations = equations_of(term, objective, state)
    below = [make_dense_coupling(equations.coupling, distance) for distance in (1, 2)]
    frames, n = equations.gradient.shape
    for frame, unknown in ((0, 0), (3, 2), (6, 1), (7, 4), (11, 5)):
        step = np.zeros((frames, n))
        step[frame, unknown] = STEP
        column = (gradient(state.advanced(step)) - gradient(state.advanced(-step))) / (2 * STEP)
        expected = np.zeros((frames, n))
        expected[frame] = equations.diagonal[frame, :, unknown]
        for distance, blocks in enumerate(below, start=1):
            if frame + distance < frames:
                expected[frame + distance] = blocks[frame][:, unknown]
            if frame >= distance:
                expected[frame - distance] = blocks[frame - distance][unknown]
        assert column == pytest.approx(expected, abs=1e-6 * np.abs(equations.diagonal).max())


@pytest.mark.parametrize('kind', TERMS)
def test_nothing_couples_two_sequences(
    objective_and_state: tuple[JointObjective, State], kind: type[Term]
) -> None:
    objective, state = objective_and_state
    equations = equations_of(objective.find_term(kind), objective, state)
    second = objective.batch.starts[1]
    for distance in (1, 2):
        blocks = make_dense_coupling(equations.coupling, distance)
        assert (blocks[second - distance : second] == 0).all()


@pytest.mark.parametrize('kind', TERMS)
def test_first_base_poses_alone_are_all_of_them_with_the_others_at_zero(
    objective_and_state: tuple[JointObjective, State], kind: type[Term]
) -> None:
    objective, state = objective_and_state
    few = objective.with_components(3)
    theta = np.where(np.arange(COMPONENTS) < 3, state.theta, 0.0)
    whole = State(theta, state.rotation, state.log_scale, state.translation)
    costs = [o.find_term(kind).cost(o.fit(s)) for o, s in ((objective, whole), (few, whole.with_components(3)))]
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)


def test_motion_at_constant_velocity_has_no_acceleration_at_any_times(
    objective_and_state: tuple[JointObjective, State], rng: np.random.Generator
) -> None:
    objective, state = objective_and_state
    times = np.cumsum(rng.uniform(0.01, 0.2, len(state.theta)))
    batch = Batch(times, objective.batch.starts, objective.batch.counts)
    theta = times[:, None] * rng.normal(size=(1, COMPONENTS)) + rng.normal(size=(1, COMPONENTS))
    steady = objective.fit(State(theta, state.rotation, state.log_scale, state.translation))
    shaken = objective.fit(State(theta**2, state.rotation, state.log_scale, state.translation))
    term = PoseAcceleration.build(1.0, 1.0, batch)
    assert term.cost(steady) == pytest.approx(0.0, abs=1e-15 / np.diff(times).min() ** 3)
    assert term.cost(shaken).sum() > 1e-3


def test_acceleration_of_a_parabola_is_its_second_derivative_at_any_rate(
    objective_and_state: tuple[JointObjective, State],
) -> None:
    objective, state = objective_and_state
    for rate in (10.0, 30.0):
        times = np.arange(len(state.theta)) / rate
        theta = np.tile(0.5 * times[:, None] ** 2, (1, COMPONENTS))  # acceleration 1 m/s^2
        fit = objective.fit(State(theta, state.rotation, state.log_scale, state.translation))
        term = PoseAcceleration.build(3.0, 1.0, Batch.of_times([times]))
        inner = len(times) - 2
        assert term.cost(fit).sum() == pytest.approx(3.0 * COMPONENTS * inner / rate, rel=1e-9)


def test_reprojection_of_a_far_camera_is_weak_perspective(
    objective_and_state: tuple[JointObjective, State],
) -> None:
    objective, state = objective_and_state
    near = objective.reprojection
    far = type(near)(near.image, near.weight, near.variance_ratio, near.robust_scale, near.focal * 1e9)
    flat = type(near)(near.image, near.weight, near.variance_ratio, near.robust_scale, near.focal * math.inf)
    scaled = objective.fit(state).scaled_poses
    errors = [r.measure(scaled, state.translation, settle_translation=False)[2] for r in (far, flat, near)]
    assert errors[0] == pytest.approx(errors[1], abs=1e-9)
    assert np.abs(errors[2] - errors[1]).max() > 1e-3
