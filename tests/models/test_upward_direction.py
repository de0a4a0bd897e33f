# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The direction upwards that a pose shows: against the formula of the module, and on walks."""

from __future__ import annotations

import numpy as np
import pytest

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
