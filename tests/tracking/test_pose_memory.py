# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The memory of key poses: its distance is that of the formula, and it recalls what looks alike and is bounded."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from tests.support.motion_files import make_poses
from tests.support.swinging_body import make_swinging_body

JOINTS = len(CMU15.joints)
POSES = make_poses()


def see(pose: np.ndarray, scale: float = 100.0) -> np.ndarray:
    """Return the image (15, 2) of a pose in px."""
    return pose[:, :2] * scale + [320.0, 240.0]


def test_the_distance_is_that_of_the_formula() -> None:
    rng, weight = np.random.default_rng(0), np.ones(JOINTS)
    pose = POSES[0] - POSES[0].mean(axis=0)
    torso = np.linalg.norm(pose[CMU15.index('neck')] - pose[CMU15.index('pelvis')])
    weight[[3, 7]] = 0.0
    memory = KeyPoseMemory(beta=0.5, capacity=3)
    memory.remember(see(pose), weight, pose)
    seen_now = np.ones(JOINTS)
    seen_now[11] = 0.0
    points = see(pose, 250.0) + rng.normal(0, 10, (JOINTS, 2))

    common = (weight > 0) & (seen_now > 0)
    key = see(pose)[common] / (100.0 * torso)
    rows = np.concatenate([np.column_stack([key[:, i], np.eye(2)[[i] * len(key)]]) for i in range(2)])
    s, *t = np.linalg.lstsq(rows, points[common].T.ravel(), rcond=None)[0]
    both = np.linalg.norm((points[common] - t) / s - key, axis=1).mean()
    share = common.sum() / JOINTS
    recalled = memory.recall(points, seen_now)
    assert recalled is not None
    assert recalled.distance == pytest.approx(both * share + 1 - share)
    assert memory.recall(points, np.where(np.arange(JOINTS) < 5, 1.0, 0.0)) is None, 'too few joints'
    memory.beta = recalled.distance
    assert memory.recall(points, seen_now) is None


def test_a_remembered_pose_is_recalled_and_the_memory_is_bounded() -> None:
    poses, _ = make_swinging_body(200)
    weight = np.ones(15)

    def image(pose: np.ndarray) -> np.ndarray:
        return 150.0 * pose[:, :2] + [300, 200]

    memory = KeyPoseMemory(beta=0.02, capacity=4)
    assert memory.recall(image(poses[0]), weight) is None
    for pose in poses[:100:10]:
        memory.remember(image(pose), weight, pose)
    assert len(memory.poses) == 4
    newest = [p - p.mean(axis=0) for p in poses[60:100:10]]
    assert np.array([p.pose for p in memory.poses]) == pytest.approx(np.array(newest))
    known = poses[90]
    partly = weight.copy()
    partly[4] = 0
    seen = 2.0 * image(known) - 70
    seen[4] = np.nan
    memory.beta = 0.2
    found = memory.recall(np.nan_to_num(seen), partly)
    memory.beta = 0.02
    assert found is not None
    assert found.pose == pytest.approx(known - known.mean(axis=0))
    assert found.scale == pytest.approx(300.0)
    again = found.scale * found.pose[:, :2] + found.translation
    assert again[partly > 0] == pytest.approx(seen[partly > 0])
    assert memory.recall(image(poses[90] * [1, 0.4, 1]), weight) is None
    before = memory.poses[:3]
    memory.remember(image(known), weight, known)
    assert memory.poses[:3] == before
    few = np.zeros(15)
    few[:3] = 1
    assert memory.recall(image(known), few) is None
