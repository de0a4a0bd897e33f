# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of Algorithm 1: synthetic walks, the steps of its halves, its linear solver, and rejected input."""

import dataclasses
from types import ModuleType

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import (
    CameraStepObjective,
    WeakPerspectiveCameras,
    fit_cameras_closed_form,
    subtract_weighted_centroid,
)
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers import alternation
from mocap_ros.solvers.alternation import reconstruct
from mocap_ros.solvers.window import Window
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.evaluation_data import shared
from tests.support.synthetic_walk import compute_mpjpe, make_noisy_window, make_walk


def test_closed_form_camera_is_close_on_exact_points(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    weight = np.ones(points.shape[:2])
    weight[3, 5] = 0
    fitted = fit_cameras_closed_form(walk_model.poses(theta), points, weight, times, window=0.0)
    assert fitted.scale == pytest.approx(cameras.scale, rel=1.1 * 0.0439)  # measured: 0.0439
    assert np.abs(fitted.rotation - cameras.rotation).max() < 1.1 * 0.0525  # measured


def test_camera_step_descends(walk_model: BasePoses) -> None:
    theta, cameras, points, _ = make_walk(walk_model, frames=6)
    rng = np.random.default_rng(1)
    weight = rng.uniform(0.2, 1, points.shape[:2])
    body, _ = subtract_weighted_centroid(walk_model.poses(theta), weight)
    image, _ = subtract_weighted_centroid(points / 200, weight)
    problem = CameraStepObjective(body, image, weight, np.full(5, 0.3))
    start = WeakPerspectiveCameras(
        cameras.scale / 200 * 1.1, rotation_from_vector(0.2 * rng.normal(size=(6, 3))) @ cameras.rotation
    )
    large_damping = 1e8
    step = problem.gauss_newton_step(start, np.full(6, large_damping))
    # Under a large damping the step is minus the gradient over the scaled diagonal: each frame descends.
    is_even = np.arange(6) % 2 == 0
    moved = step.where(is_even, start)
    assert (problem.local_cost(moved) <= problem.local_cost(start) + 1e-12)[is_even].all()

    turned = start.rotation[2]
    gradient = np.empty(3)
    for axis in range(3):
        costs = []
        for sign in (1, -1):
            rotation = start.rotation.copy()
            rotation[2] = rotation_from_vector(sign * 1e-5 * np.eye(3)[axis]) @ turned
            costs.append(problem.local_cost(WeakPerspectiveCameras(start.scale, rotation))[2])
        gradient[axis] = (costs[0] - costs[1]) / 2e-5
    delta = (step.rotation[2] @ turned.T - np.eye(3)) * large_damping
    direction = np.array([delta[2, 1], delta[0, 2], delta[1, 0]])
    assert (np.abs(gradient) > 1e-4).all()
    assert (np.sign(direction[np.abs(gradient) > 1e-4]) == -np.sign(gradient[np.abs(gradient) > 1e-4])).all()


def test_recovers_a_synthetic_walk(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    config = SolverConfig(
        prior_weight=1e-7, bone_weight=0.05, flip_weight=1e-5, components=4,
        max_iterations=400, tolerance=1e-7,
    )  # fmt: skip
    result = reconstruct(Window(points, np.ones(points.shape[:2]), times), walk_model, config)
    assert compute_mpjpe(result, walk_model, theta, cameras) < 1.1 * 1.67  # mm; measured: 1.667
    assert result.residual.max() < 1.1 * 0.25  # px; measured: 0.249
    assert result.translation == pytest.approx(np.tile([320, 240], (len(times), 1)), abs=1e-3)  # px


@settings(max_examples=25)
@example(seed=405, bone=0.0, prior=0.0, flip=0.0, missing=0.5)  # nothing determines the weights of a frame
@given(
    seed=st.integers(0, 1000),
    bone=st.floats(0, 100),
    prior=st.floats(0, 1e-2),
    flip=st.floats(0, 1),
    missing=st.floats(0, 0.5),
)
def test_objective_never_rises(
    walk_model: BasePoses, seed: int, bone: float, prior: float, flip: float, missing: float
) -> None:
    config = SolverConfig(bone_weight=bone, prior_weight=prior, flip_weight=flip, components=8, max_iterations=6)
    result = reconstruct(make_noisy_window(walk_model, seed, missing), walk_model, config)
    steps = np.diff(result.history)
    assert (steps <= 1e-9 * np.abs(result.history[0])).all()
    assert np.isfinite(result.joints).all()


def test_woodbury_solution_equals_the_dense_one(rng: np.random.Generator) -> None:
    frames, k, bones = 5, 4, 3
    a = rng.normal(size=(frames, 9, k))
    coupling = rng.normal(size=(frames, k, bones))
    strength = 0.3
    blocks = np.swapaxes(a, -1, -2) @ a + frames * strength * coupling @ np.swapaxes(coupling, -1, -2)
    gradient = rng.normal(size=(frames, k))
    dense = np.zeros((frames * k, frames * k))
    for f in range(frames):
        dense[f * k : (f + 1) * k, f * k : (f + 1) * k] = blocks[f]
    g = coupling.reshape(frames * k, bones)
    dense -= strength * g @ g.T
    x = alternation.solve_coupled_blocks(blocks, coupling, strength, gradient, damping=0.0)
    assert x.ravel() == pytest.approx(np.linalg.solve(dense, gradient.ravel()), rel=1e-8)


def test_bone_regulariser_keeps_bone_lengths_constant(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model)
    points = points + np.random.default_rng(3).normal(size=points.shape)

    def bone_length_std(weight: float) -> float:
        config = SolverConfig(bone_weight=weight, components=10)
        result = reconstruct(Window(points, np.ones(points.shape[:2]), times), walk_model, config)
        ends = np.array(CMU15.bones).T
        length = np.linalg.norm(result.joints[:, ends[1]] - result.joints[:, ends[0]], axis=-1)
        return float(length.std(axis=0).mean())

    assert bone_length_std(50.0) < 1.1 * 0.145 * bone_length_std(0.0)  # measured: 1.0 mm and 6.8 mm


def test_a_hidden_limb_is_reconstructed(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    weight = np.ones(points.shape[:2])
    weight[:, [CMU15.index('lelbow'), CMU15.index('lwrist')]] = 0
    points[weight == 0] = 0
    config = SolverConfig(components=4, prior_weight=1e-6)
    result = reconstruct(Window(points, weight, times), walk_model, config)
    assert compute_mpjpe(result, walk_model, theta, cameras) < 1.1 * 17.8  # mm, measured


def test_frames_without_any_joint_have_poses_but_no_residual(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model)
    weight = np.ones(points.shape[:2])
    weight[10:14] = 0
    result = reconstruct(Window(points, weight, times), walk_model, SolverConfig(components=6))
    assert np.isfinite(result.joints).all()
    assert np.isnan(result.residual[10:14]).all()


def test_same_input_same_output(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model)
    weight = np.ones(points.shape[:2])
    a, b = (reconstruct(Window(points, weight, times), walk_model, SolverConfig()) for _ in range(2))
    assert (a.joints == b.joints).all()


def test_mismatched_or_empty_windows_are_rejected(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model)
    weight = np.ones(points.shape[:2])
    with pytest.raises(InputError, match='do not fit'):
        Window(points[:-1], weight, times)
    with pytest.raises(InputError, match='nothing to reconstruct'):
        Window(points, weight * 0, times)


def test_unseen_walk_of_a_trained_subject(protocol: ModuleType) -> None:
    """The MPJPE of trial 35/02, left out of training and seen from the side, is 7 mm."""
    data = shared('data/cmu/cmu15_30fps.npz')
    trials = [t for t in load_trials(data) if t.subject == '35' and t.category == 'walk']
    model = fit_base_poses(
        [t.poses for t in trials if t.name != '35_02'], alignment='heading', mirror=True, bodies=2
    )
    archive = np.load(data)
    view = protocol.make_view(archive['35_02'], archive['_joints'], heading=90)
    keypoints = view['keypoints'].astype(float)
    result = reconstruct(
        Window(keypoints[..., :2], keypoints[..., 2], view['timestamps']), model,
        dataclasses.replace(SolverConfig(), components=30),
    )  # fmt: skip
    score = protocol.score(result.joints, CMU15.joints, view['joints3d'], view['joints3d_names'])
    assert score['failed_frames'] == 0
    assert score['mpjpe_mm'] < 1.1 * 7.13  # mm, measured
