# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The rivals reconstruct without error what their models can represent."""

from __future__ import annotations

import numpy as np
import rivals
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import rotation_from_vector

Array = NDArray[np.float64]

FRAMES = 60
JOINTS = 15


def make_orbit(frames: int = FRAMES) -> Array:
    """Cameras (F, 3, 3) that turn about the body and nod."""
    t = np.linspace(0, 1, frames)
    about_y = rotation_from_vector(np.stack([0 * t, 5 * t, 0 * t], axis=1))
    nod = rotation_from_vector(np.stack([0.5 * np.sin(7 * t), 0 * t, 0.3 * np.cos(5 * t)], axis=1))
    return nod @ about_y


def make_shapes(coefficients: Array) -> Array:
    """Shapes (F, J, 3) m: a rigid one plus deformations with these coefficients (F, K - 1)."""
    basis = np.random.default_rng(0).standard_normal((1 + coefficients.shape[1], JOINTS, 3)) * 0.3
    basis -= basis.mean(axis=1, keepdims=True)
    return np.asarray(basis[0] + 0.4 * np.einsum('fk,kjc->fjc', coefficients, basis[1:]))


def compute_error(found: Array, truth: Array) -> float:
    """Return the mean distance of the joints in m, of the poses or of their mirror images in depth."""
    return min(float(np.linalg.norm(p - truth, axis=-1).mean()) for p in (found, rivals.reflect_in_depth(found)))


def make_motion(shapes: int) -> Array:
    """Poses (F, J, 3) m of so many basis shapes, whose coefficients are cosines of time."""
    phase = np.pi * (np.arange(FRAMES) + 0.5)[:, None] * np.arange(1, shapes) / FRAMES
    return rivals.turn_to_camera(make_shapes(np.sqrt(2) * np.cos(phase)), make_orbit())


def test_the_factorisation_reconstructs_rigid_and_deforming_bodies() -> None:
    for shapes in (1, 2):
        truth = make_motion(shapes)
        assert compute_error(rivals.factorise_points(truth[..., :2], shapes), truth) < 1e-6  # m


def test_sparse_representation_finds_a_pose_of_the_dictionary() -> None:
    rng = np.random.default_rng(0)
    dictionary = rng.standard_normal((30, JOINTS, 3))
    dictionary -= dictionary.mean(axis=1, keepdims=True)
    cameras = make_orbit()[::4]
    truth = rivals.turn_to_camera(dictionary[rng.integers(30, size=len(cameras))], cameras)
    found = rivals.represent_sparsely(truth[..., :2], dictionary, 1e-3)
    assert np.linalg.norm(found - truth, axis=-1).mean(axis=1).max() < 1e-4  # m, of poses of 1.6 m


@settings(max_examples=50)
@given(seed=st.integers(0, 10**6), amount=st.floats(0, 5))
def test_the_spectral_norm_is_shrunk_as_by_singular_values(seed: int, amount: float) -> None:
    matrix = np.random.default_rng(seed).standard_normal((2, 3))
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    # s less its projection on the l1 ball: lower the larger one first, then both alike
    level = max(s[0] - amount, (s.sum() - amount) / 2, 0.0) if amount < s.sum() else 0.0
    expected = u @ np.diag(np.minimum(s, level)) @ vt
    np.testing.assert_allclose(rivals.shrink_spectral_norm(matrix, amount), expected, atol=1e-9)
