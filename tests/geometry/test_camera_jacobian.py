# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The camera Jacobian: equal to finite differences of a projected point, in new arrays and in views."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, camera_jacobian, fill_rotation_jacobian
from mocap_ros.geometry.rotations import rotation_from_vector

STEP = 1e-6  # of the central differences; their error is about its square, that of rounding 1e-10


def differentiate(points: np.ndarray) -> np.ndarray:
    """(..., 3, 4) central differences of points that a step of the camera rotates and scales."""

    def move(step: np.ndarray) -> np.ndarray:
        return np.exp(step[3]) * (points @ rotation_from_vector(step[:3]).T)

    steps = STEP * np.eye(CAMERA_UNKNOWNS)
    return np.stack([(move(step) - move(-step)) / (2 * STEP) for step in steps], axis=-1)


@pytest.mark.parametrize('rows', [2, 3])
def test_jacobian_agrees_with_finite_differences(rng: np.random.Generator, rows: int) -> None:
    points = rng.normal(size=(4, 5, 3))
    assert camera_jacobian(points, rows) == pytest.approx(differentiate(points)[..., :rows, :], abs=1e-8)


def test_rotation_alone_leaves_the_column_of_the_scale(rng: np.random.Generator) -> None:
    points = rng.normal(size=(6, 3))
    out = np.full((6, 3, CAMERA_UNKNOWNS), 7.0)
    fill_rotation_jacobian(out[..., :3], points)
    assert out[..., :3] == pytest.approx(differentiate(points)[..., :3], abs=1e-8)
    assert (out[..., 3] == 7.0).all()
