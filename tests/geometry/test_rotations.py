# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations as vectors and quaternions, and the compiled functions against the plain ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.rotations import (
    fit_rotation,
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation,
    write_best_rotation,
    write_rotation_from_vector,
)


def best_rotation(products: np.ndarray) -> np.ndarray:
    out = np.empty((3, 3))
    write_best_rotation(np.ascontiguousarray(products), out)
    return out


@pytest.mark.parametrize('angle', [0.0, 1e-9, 0.3, 3.0, 7.0])
def test_rotation_from_vector(rng: np.random.Generator, angle: float) -> None:
    axis = rng.normal(size=3)
    vector, out = angle * axis / np.linalg.norm(axis), np.empty((3, 3))
    write_rotation_from_vector(vector, out)
    assert out == pytest.approx(rotation_from_vector(vector), abs=1e-14)


@pytest.mark.parametrize('thickness', [1.0, 1e-3, 0.0], ids=['solid', 'flat', 'planar'])
@pytest.mark.parametrize('is_mirrored', [False, True])
def test_best_rotation_is_that_of_the_singular_value_decomposition(
    rng: np.random.Generator, thickness: float, is_mirrored: bool
) -> None:
    for size in (1e-6, 1.0, 1e6):
        poses = rng.normal(size=(15, 3)) * [1, 1, thickness]
        target = size * (poses @ rotation_from_vector(rng.normal(size=3)).T + 0.1 * rng.normal(size=(15, 3)))
        if is_mirrored:
            target = target * [1, 1, -1]
        assert best_rotation(target.T @ poses) == pytest.approx(fit_rotation(poses, target), abs=1e-9)


def test_rotations_as_vectors_and_quaternions() -> None:
    turns = Rotation.random(200, random_state=0)
    half = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]
    for matrix in [np.eye(3), *half, *turns.as_matrix()]:
        assert Rotation.from_quat(quaternion_from_rotation(matrix)).as_matrix() == pytest.approx(matrix, abs=1e-12)
    assert rotation_from_vector(vector_from_rotation(turns.as_matrix())) == pytest.approx(
        turns.as_matrix(), abs=1e-9
    )
