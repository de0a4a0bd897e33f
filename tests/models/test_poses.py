# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a pose shows: the direction upwards, and standard deviations of its joints."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models import joint_std
from mocap_ros.models.joint_std import compute_joint_covariance, estimate_joint_std
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.models.upward_direction import MASSES, SUPPORT_AHEAD, find_upward
from mocap_ros.skeleton import CMU15

WALK = load_base_poses('walk')  # aligned by heading: z is up in every pose


def walking_poses(rng: np.random.Generator) -> np.ndarray:
    return WALK.poses(0.7 * rng.normal(size=(20, len(WALK.std))) * WALK.std)


def find_upward_plainly(pose: np.ndarray) -> np.ndarray:
    at = {name: pose[i] for i, name in enumerate(CMU15.joints)}
    lever = MASSES @ pose - (at['lankle'] + at['rankle']) / 2
    ahead = np.cross(at['lhip'] - at['rhip'] + at['lshoulder'] - at['rshoulder'], lever)
    legs = [np.linalg.norm(at[s + a] - at[s + b]) for s in 'lr' for a, b in (('hip', 'knee'), ('knee', 'ankle'))]
    length = np.linalg.norm(at['neck'] - at['pelvis']) + sum(legs) / 2
    upward = lever - SUPPORT_AHEAD * length * ahead / np.linalg.norm(ahead)
    return upward / np.linalg.norm(upward)


def test_the_kernel_computes_the_formula(rng: np.random.Generator) -> None:
    poses = rng.normal(size=(5, 15, 3))
    assert find_upward(poses) == pytest.approx(np.array([find_upward_plainly(p) for p in poses]), abs=1e-12)


def test_walkers_show_the_vertical(rng: np.random.Generator) -> None:
    angles = np.degrees(np.arccos(find_upward(walking_poses(rng))[:, 2]))
    assert np.median(angles) < 4, 'degrees; 3.2 over all motions of the training persons'

    assert np.isnan(find_upward(np.full((1, 15, 3), np.nan))).all()
    assert find_upward(np.zeros((0, 15, 3))).shape == (0, 3)


POSTERIOR_STD = np.array([0.01, 0.01, 0.05])  # m
INFERRED = np.array([False, True, False])
LIFTER_STD = np.array([[0.02, 0.03, 0.06], [0.02, 0.03, 0.06], [np.nan] * 3])  # m; 0.07 m together


def test_the_lifter_decides_where_it_lifted_and_noise_and_hiding_make_joints_less_certain() -> None:
    posterior = estimate_joint_std(POSTERIOR_STD, INFERRED)
    seen, inferred, not_lifted = estimate_joint_std(POSTERIOR_STD, INFERRED, LIFTER_STD)
    noisy = estimate_joint_std(POSTERIOR_STD, INFERRED, LIFTER_STD, 0.03)
    assert posterior[1] > posterior[0] > joint_std.POSTERIOR_FLOOR_M
    assert inferred > seen
    assert (seen, inferred) == pytest.approx((0.7 * 0.07, 0.8 * 0.07))
    assert not_lifted == posterior[2]
    assert noisy[0] > seen
    assert noisy[1:].tolist() == [inferred, not_lifted], 'the image says nothing of it, and the posterior knows it'
    assert estimate_joint_std(np.zeros(3), INFERRED) == pytest.approx(joint_std.POSTERIOR_FLOOR_M)


def test_covariances_are_longest_along_the_line_of_sight(rng: np.random.Generator) -> None:
    position = rng.normal(size=(4, 3))
    covariance = compute_joint_covariance(np.full(4, 0.3), position)
    values, vectors = np.linalg.eigh(covariance)
    assert values.sum(axis=1) == pytest.approx(np.full(4, 0.09))
    assert np.abs((vectors[..., 2] * position).sum(axis=1)) == pytest.approx(np.linalg.norm(position, axis=1))
