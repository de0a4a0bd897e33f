# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Initial values from lifted poses: weights, scale and rotation of exact poses, in any direction."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.joint.lifted_start import fit_lifted_poses


@pytest.mark.parametrize('scale', [1e-3, 200.0])
def test_exact_poses_give_their_weights_and_cameras(
    walk_model: BasePoses, rng: np.random.Generator, scale: float
) -> None:
    theta = 0.1 * walk_model.std * rng.normal(size=(30, len(walk_model.std)))
    rotation = Rotation.random(30, random_state=0).as_matrix()
    poses = scale * walk_model.poses(theta) @ np.swapaxes(rotation, -1, -2)
    found = fit_lifted_poses(LiftedPoses(poses, np.full(poses.shape, 1e-6 * scale)), walk_model)
    assert found.scale == pytest.approx(np.full(30, scale), rel=0.01)
    assert found.theta == pytest.approx(theta, abs=0.02)
    own = fit_rotation(walk_model.poses(found.theta), poses)
    assert found.rotation == pytest.approx(own, abs=1e-3)
    assert found.rotation == pytest.approx(rotation, abs=0.02)
