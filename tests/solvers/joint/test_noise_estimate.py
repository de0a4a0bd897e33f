# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The estimate of the image noise against its formula."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.noise_estimate import MIN_FREE_SHARE, choose_counted_frames, estimate_noise
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.window import Window, initialise_from_mean_pose
from tests.support.synthetic_walk import make_walk

COUNTS = (1, 4, 40)


def make_fit(
    model: BasePoses, rng: np.random.Generator, focal: float, seen: int = 15
) -> tuple[JointObjective, Fit]:
    """Three sequences with missing points under different noise, and a fit near their mean poses.

    No more than the first `seen` joints are seen.
    """
    windows = []
    for frames in COUNTS:
        _, _, points, times = make_walk(model, frames=frames)
        weight = rng.uniform(0.3, 1, points.shape[:2]) * (rng.random(points.shape[:2]) < 0.8)
        weight[:1, :4] = 1.0
        weight[:, seen:] = 0.0
        windows.append(Window(points + rng.normal(size=points.shape), weight, times, focal=focal))
    starts = [initialise_from_mean_pose(w, model, 1.0) for w in windows]
    units = np.array([np.median(s.cameras.scale) for s in starts])
    objective = JointObjective.build(windows, units, model, SolverConfig(prior_weight=0.0, bone_weight=0.0))
    objective = objective.with_noise(np.array([0.005, 0.01, 0.03]))
    state = objective.initial_state(starts, units)
    step = 0.02 * rng.normal(size=(sum(COUNTS), len(model.std) + CAMERA_UNKNOWNS))
    return objective, objective.with_optimal_translation(state.advanced(step))


def test_few_frames_are_counted_and_all_sequences_have_some() -> None:
    starts, counts = np.array([0, 1, 5, 45]), np.array([1, 4, 40, 6])
    is_free = np.ones(51, bool)
    frames = choose_counted_frames(starts, counts, is_free)
    assert frames.tolist() == [0, 1, 3, 5, 13, 21, 29, 37, 45, 47, 49]
    is_free[[0, 1, 45]] = False
    frames = choose_counted_frames(starts, counts, is_free)
    assert frames.tolist() == [2, 3, 4, 5, 13, 21, 29, 37, 46, 48, 50], 'held frames are not counted'


@pytest.mark.parametrize('focal', [math.inf, 300.0])
def test_absorbed_coordinates_are_the_trace_of_the_share_of_the_image(
    walk_model: BasePoses, rng: np.random.Generator, focal: float
) -> None:
    objective, fit = make_fit(walk_model.truncate(6), rng, focal)
    of_image = NormalEquations.begin(fit, objective.basis, len(objective.bones.weight), objective.is_free)
    objective.reprojection.add_to(of_image, fit)
    of_image.transfer_from_joints()
    equations = objective.normal_equations(fit)
    frames = np.array([0, 3, 17])
    expected = [np.trace(np.linalg.solve(equations.diagonal[t], of_image.diagonal[t])) + 2 for t in frames]
    assert equations.count_absorbed_coordinates(frames) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize('seen', [15, 4])
def test_noise_is_the_residual_over_the_free_coordinates(
    walk_model: BasePoses, rng: np.random.Generator, seen: int
) -> None:
    """With few seen joints the unknowns absorb all coordinates but the least share."""
    objective, fit = make_fit(walk_model.truncate(6), rng, 300.0, seen)
    reprojection, batch = objective.reprojection, objective.batch
    equations = objective.normal_equations(fit)
    absorbed = equations.count_absorbed_coordinates(np.arange(sum(COUNTS)))
    loss = reprojection.cost(fit) * reprojection.variance_ratio
    limited = []
    found = estimate_noise(reprojection, batch, objective.is_free, fit, equations)
    for first, count, noise in zip(batch.starts, batch.counts, found, strict=True):
        frames = choose_counted_frames(np.array([first]), np.array([count]), objective.is_free)
        coordinates = 2 * int((reprojection.weight[first : first + count] > 0).sum())
        free = coordinates - count * absorbed[frames].mean()
        least = MIN_FREE_SHARE * coordinates + 1
        limited.append(free < least)
        squares = loss[first : first + count].sum()
        assert noise == pytest.approx(np.sqrt(squares / max(free, least)), rel=1e-12)
    assert any(limited) == (seen == 4)
