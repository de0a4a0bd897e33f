# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The joint solver: right minimum, a batch that equals its parts."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.joint.lifted_start import fit_lifted_poses
from mocap_ros.solvers.window import (
    Reconstruction,
    Window,
    initialise_from_mean_pose,
    reverse_depth,
)
from tests.support.synthetic_walk import make_walk

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


def window(model: BasePoses, frames: int = 30, seed: int = 0, noise: float = 2.0) -> Window:
    """A noisy window with missing points and irregular times."""
    _, _, points, times = make_walk(model, frames=frames, seed=seed)
    rng = np.random.default_rng(seed)
    weight = rng.uniform(0.3, 1, points.shape[:2]) * (rng.random(points.shape[:2]) > 0.1)
    times = times + rng.uniform(0, 0.01, frames)
    return Window(points + noise * rng.normal(size=points.shape), weight, times)


def test_reaches_the_alternations_minimum_or_a_lower_one(walk_model: BasePoses) -> None:
    config = dataclasses.replace(PLAIN, tolerance=1e-9, max_iterations=3000)
    w = window(walk_model)
    slow = alternation.reconstruct(w, walk_model, config)
    (fast,) = joint.solve([w], walk_model, config)
    assert fast.history[0] == pytest.approx(slow.history[0], rel=1e-9)
    assert fast.cost <= slow.cost * (1 + 1e-3), 'the same or a neighbouring minimum'
    assert np.argmax(np.array(fast.history) <= fast.cost * (1 + 1e-4)) <= 15


@pytest.mark.parametrize('scale', [1e-3, 200.0])
def test_lifted_poses_give_their_weights_and_cameras(
    walk_model: BasePoses, rng: np.random.Generator, scale: float
) -> None:
    theta = 0.1 * walk_model.std * rng.normal(size=(30, len(walk_model.std)))
    rotation = Rotation.random(30, random_state=0).as_matrix()
    poses = scale * walk_model.poses(theta) @ np.swapaxes(rotation, -1, -2)
    found = fit_lifted_poses(LiftedPoses(poses, np.full(poses.shape, 1e-6 * scale)), walk_model)
    assert found.scale == pytest.approx(np.full(30, scale), rel=0.01)
    assert found.theta == pytest.approx(theta, abs=0.02)
    assert found.rotation == pytest.approx(rotation, abs=0.02)


def test_a_batch_gives_what_each_sequence_gives_alone(walk_model: BasePoses) -> None:
    config = SolverConfig(smooth_weight=1e-5, robust_scale=0.05, components=10, tolerance=1e-10)
    windows = [window(walk_model, frames, seed) for frames, seed in ((20, 1), (9, 2), (14, 3))]
    together = joint.solve(windows, walk_model, config)
    for one, w in zip(together, windows, strict=True):
        (alone,) = joint.solve([w], walk_model, config)
        assert one.joints == pytest.approx(alone.joints, abs=1e-7)
        assert one.iterations == alone.iterations


def test_the_necker_reversal_mends_a_camera_that_is_reversed(walk_model: BasePoses) -> None:
    clean = window(walk_model, noise=0.5)
    start = initialise_from_mean_pose(clean, walk_model.truncate(10), 1.0)
    (right,) = joint.solve([clean], walk_model, SolverConfig(components=10))
    unit = float(np.median(start.cameras.scale))
    misled = dataclasses.replace(clean, start=reverse_depth(start), unit=unit)
    (one,) = joint.solve_hypotheses([misled], walk_model, SolverConfig(components=10, heading_hypotheses=1))
    (best,) = joint.solve_hypotheses([misled], walk_model, SolverConfig(components=10, heading_hypotheses=2))

    def apart(result: Reconstruction) -> float:
        return float(np.linalg.norm(result.joints - right.joints, axis=-1).mean())

    assert apart(one) > 0.05
    assert apart(best) < 0.01


def test_noise_is_found(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model, frames=60)
    rng = np.random.default_rng(5)
    for px in (1.0, 4.0):
        noisy = Window(points + px * rng.normal(size=points.shape), np.ones(points.shape[:2]), times)
        (result,) = joint.solve([noisy], walk_model, SolverConfig())
        assert result.noise == pytest.approx(px / 205, rel=0.2)


def test_noise_below_the_floor_is_taken_for_the_floor(walk_model: BasePoses) -> None:
    _, _, points, times = make_walk(walk_model, frames=30)
    window = Window(points, np.ones(points.shape[:2]), times)
    (found,) = joint.solve([window], walk_model, SolverConfig())
    (limited,) = joint.solve([window], walk_model, SolverConfig(noise_floor=0.02))
    (expected,) = joint.solve([dataclasses.replace(window, noise=0.02)], walk_model, SolverConfig())
    assert found.noise < 0.005
    assert limited.cost == pytest.approx(expected.cost, rel=0.01)
    assert found.cost > 2 * expected.cost
