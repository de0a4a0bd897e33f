# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations as vectors and quaternions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.rotations import (
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation,
)


def test_rotations_as_vectors_and_quaternions() -> None:
    turns = Rotation.random(200, random_state=0)
    half = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]
    for matrix in [np.eye(3), *half, *turns.as_matrix()]:
        assert Rotation.from_quat(quaternion_from_rotation(matrix)).as_matrix() == pytest.approx(matrix, abs=1e-12)
    assert rotation_from_vector(vector_from_rotation(turns.as_matrix())) == pytest.approx(
        turns.as_matrix(), abs=1e-9
    )
