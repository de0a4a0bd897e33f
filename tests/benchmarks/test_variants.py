# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the variants of the solvers that the experiments with the paper use."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from experiments.least_squares import SparseProblem
from experiments.variants.frobenius import reconstruct_with_printed_norms
from experiments.variants.heading_ring import solve_from_ring
from experiments.variants.relative_bones import solve_with_relative_bones, use_relative_bones
from experiments.variants.sines import SineSeries, fit_initial_sines, solve_with_sines
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.objective import JointObjective, read_state
from mocap_ros.solvers.joint.reference import compute_costs
from mocap_ros.solvers.window import (
    InitialValues,
    Reconstruction,
    Window,
    choose_initial_values,
    initialise_from_mean_pose,
)
from tests.support.synthetic_walk import BODY_TO_OPTICAL, compute_mpjpe, make_noisy_window, make_walk

# Algorithm 1 and the solvers beside it in the experiments neither estimate the image noise nor discount outliers.
PAPER = SolverConfig(adapt_noise=False, robust_scale=0.0, prior_weight=1e-7, bone_weight=0.05, flip_weight=1e-5)


def make_window(points: np.ndarray, times: np.ndarray) -> Window:
    return Window(points, np.ones(points.shape[:2]), times)


def test_printed_norms_recover_a_synthetic_walk(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    config = dataclasses.replace(PAPER, components=4, max_iterations=400, tolerance=1e-7)
    result = reconstruct_with_printed_norms(make_window(points, times), walk_model, config)
    assert compute_mpjpe(result, walk_model, theta, cameras) < 1e-3  # mm; measured: 1e-6
    assert result.residual.max() < 1e-3  # px; measured: 2e-7


@settings(max_examples=15)
@given(
    seed=st.integers(0, 1000),
    bone=st.floats(0, 100),
    prior=st.floats(0, 1e-2),
    flip=st.floats(0, 1),
    missing=st.floats(0, 0.5),
)
def test_the_objective_of_the_printed_norms_never_rises(
    walk_model: BasePoses, seed: int, bone: float, prior: float, flip: float, missing: float
) -> None:
    config = SolverConfig(bone_weight=bone, prior_weight=prior, flip_weight=flip, components=8, max_iterations=6)
    history = reconstruct_with_printed_norms(
        make_noisy_window(walk_model, seed, missing), walk_model, config
    ).history
    assert (np.diff(history) <= 1e-9 * np.abs(history[0])).all()


def test_relative_bones_weigh_each_bone_by_its_length(walk_model: BasePoses) -> None:
    theta, _, points, times = make_walk(walk_model, frames=9)
    window = make_window(points, times)
    batch = Batch.build([window], np.array([200.0]), walk_model)
    plain = JointObjective.build(batch, walk_model, SolverConfig(bone_weight=3.0, robust_scale=0.0))
    relative = use_relative_bones(plain)
    start = InitialValues(theta, initialise_from_mean_pose(window, walk_model, 1.0).cameras)
    state = batch.initial_state([start], np.array([200.0]))
    lengths = walk_model.skeleton.bone_lengths(walk_model.poses(theta))
    of_mean_pose = walk_model.skeleton.bone_lengths(walk_model.mean)
    spread = ((lengths - lengths.mean(axis=0)) * (of_mean_pose.mean() / of_mean_pose)) ** 2
    costs = [compute_costs(objective, state) for objective in (plain, relative)]
    assert costs[1].pop('bones').sum() == pytest.approx(3.0 * spread.sum())
    del costs[0]['bones']
    assert {name: cost.sum() for name, cost in costs[0].items()} == {n: c.sum() for n, c in costs[1].items()}


def test_relative_bones_recover_a_synthetic_walk(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model)
    config = dataclasses.replace(PAPER, components=6)
    result = solve_with_relative_bones(make_window(points, times), walk_model, config)
    assert compute_mpjpe(result, walk_model, theta, cameras) < 1.1 * 2.34  # mm; measured: 2.334


def test_a_ring_of_headings_mends_a_wrong_heading(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model, frames=30)
    clean = make_window(points, times)
    start = initialise_from_mean_pose(clean, walk_model.truncate(10), 1.0)
    config = SolverConfig(components=10)
    (right,) = joint.solve([clean], walk_model, config)
    half_turn = np.diag([-1.0, -1.0, 1.0])
    cameras = WeakPerspectiveCameras(start.cameras.scale, start.cameras.rotation @ half_turn)
    wrong = InitialValues(start.theta, cameras)
    misled = dataclasses.replace(clean, start=wrong, unit=float(np.median(cameras.scale)))

    def distance(result: Reconstruction) -> float:
        return float(np.linalg.norm(result.joints - right.joints, axis=-1).mean())

    (one,) = solve_from_ring([misled], walk_model, config, 1)
    (nine,) = solve_from_ring([misled], walk_model, config, 9)
    assert distance(one) > 0.05
    assert distance(nine) < 0.01


def test_the_jacobian_of_the_sines_agrees_with_finite_differences(rng: np.random.Generator) -> None:
    functions, times = 4, np.cumsum(rng.uniform(0.02, 0.2, 7))
    frequencies = 2 * np.pi * rng.uniform(0.7, 1.5, functions)
    series = SineSeries(rng.normal(size=(2, functions)), float(frequencies[0]), float(times[3]), frequencies)
    steps = 1e-6 * np.eye(3 * functions)
    columns = [series.with_step(s).evaluate(times) - series.with_step(-s).evaluate(times) for s in steps]
    dense = np.stack(columns, axis=-1) / 2e-6  # (N, K + 1, G)

    values = rng.normal(size=(7, 2, functions))
    matrices = np.swapaxes(values, -1, -2) @ values
    jacobian = series.jacobian(times)
    products = values @ dense
    assert jacobian.products(values) == pytest.approx(products, abs=1e-7)
    assert jacobian.sum_products(values) == pytest.approx(products.sum(axis=0), abs=1e-7)
    congruences = np.einsum('nkg,nkl,nlh->gh', dense, matrices, dense)
    assert jacobian.sum_congruences(matrices) == pytest.approx(congruences, abs=1e-6)


def test_sines_of_different_frequencies_are_recovered(walk_model: BasePoses) -> None:
    model = walk_model.truncate(3)
    frequencies_hz = np.array([0.9, 1.3, 1.8])
    times = np.arange(90) / 30
    theta = model.std * np.sin(2 * np.pi * frequencies_hz * times[:, None] + [0.0, 1.0, 2.0])
    cameras = WeakPerspectiveCameras(np.full(90, 200.0), np.tile(BODY_TO_OPTICAL, (90, 1, 1)))
    points = cameras.project(model.poses(theta)) + [320.0, 240.0]

    series = fit_initial_sines(theta, times)
    assert series.frequencies[:-1] / (2 * np.pi) == pytest.approx(
        frequencies_hz, abs=0.021
    )  # one step of the scan
    assert series.evaluate(times)[:, :-1] == pytest.approx(
        theta, abs=0.32 * model.std.max()
    )  # measured: 0.29, from the ridge
    (result,) = solve_with_sines([make_window(points, times)], model, PAPER)
    assert compute_mpjpe(result, model, theta, cameras) < 1.1 * 1.23  # mm; measured: 1.221
    assert (np.diff(result.history) <= 0).all()


def test_the_sparse_jacobian_agrees_with_finite_differences(walk_model: BasePoses) -> None:
    config = SolverConfig(adapt_noise=False)
    model, window = walk_model.truncate(3), make_noisy_window(walk_model, 5, 0.1)
    start, unit = choose_initial_values(window, model, config.start_window)
    window = dataclasses.replace(window, start=start, unit=unit)
    batch = Batch.build([window], np.array([unit]), model)
    objective = JointObjective.build(batch, model, config)
    state = read_state(objective.compile(batch.initial_state([start], np.array([unit])), settle_steps=1))
    problem = SparseProblem(objective, state)
    x = problem.pack(state) + 0.03
    columns = np.eye(len(x))[:: len(x) // 40] * 1e-6
    differences = [(problem.residuals(x + c) - problem.residuals(x - c)) / 2e-6 for c in columns]
    jacobian = problem.jacobian(x).toarray()[:, :: len(x) // 40]
    np.testing.assert_allclose(jacobian, np.transpose(differences), atol=1e-6 * np.abs(jacobian).max())
