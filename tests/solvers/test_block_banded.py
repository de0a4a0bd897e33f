# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The block Cholesky factorisation against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from mocap_ros.engine.block_banded import BlockCholesky

FRAMES, UNKNOWNS, CORNER = 7, 5, 2


def make_system(rng: np.random.Generator, distances: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks, coupling and the dense matrix; frames 3 and 4 are not coupled."""
    a = rng.normal(size=(FRAMES, UNKNOWNS, UNKNOWNS))
    blocks = a @ np.swapaxes(a, 1, 2) + 20 * np.eye(UNKNOWNS)
    diagonal = rng.normal(size=(FRAMES, distances, UNKNOWNS))
    corners = rng.normal(size=(FRAMES, distances, CORNER, CORNER))
    dense = np.zeros((FRAMES, UNKNOWNS, FRAMES, UNKNOWNS))
    for t in range(FRAMES):
        dense[t, :, t] = blocks[t]
        for d in range(distances):
            if t <= 3 < t + d + 1:
                diagonal[t, d] = corners[t, d] = 0
            if t + d + 1 < FRAMES:
                block = np.diag(diagonal[t, d])
                block[-CORNER:, -CORNER:] += corners[t, d]
                dense[t + d + 1, :, t], dense[t, :, t + d + 1] = block, block.T
    return blocks, diagonal, corners, dense.reshape(FRAMES * UNKNOWNS, -1)


@pytest.mark.parametrize('distances', [1, 2, 3])
@pytest.mark.parametrize('held', [(), (0, 3, 4)])
def test_solution_equals_the_dense_one(rng: np.random.Generator, distances: int, held: tuple[int, ...]) -> None:
    blocks, diagonal, corners, dense = make_system(rng, distances)
    is_free = ~np.isin(np.arange(FRAMES), held)
    factor = BlockCholesky(np.tril(blocks), diagonal, corners, is_free)
    free = np.repeat(is_free, UNKNOWNS)
    lower = np.zeros_like(dense)
    lower[np.ix_(free, free)] = np.linalg.cholesky(dense[np.ix_(free, free)])
    right = rng.normal(size=(FRAMES, UNKNOWNS, 4))
    found = factor.solve_lower(right.copy()).reshape(-1, 4)
    assert lower @ found == pytest.approx(np.where(free[:, None], right.reshape(-1, 4), 0.0), abs=1e-12)
    found = factor.solve_lower_transposed(right[..., 0])
    assert lower.T @ found.ravel() == pytest.approx(np.where(free, right[..., 0].ravel(), 0.0), abs=1e-12)
    assert factor.log_determinant() == pytest.approx(np.linalg.slogdet(dense[np.ix_(free, free)])[1], rel=1e-12)


def test_a_matrix_that_is_not_positive_definite_has_no_factor(rng: np.random.Generator) -> None:
    blocks, diagonal, corners, _ = make_system(rng, 1)
    for system in ((-blocks, diagonal, corners), (blocks, 100 * diagonal, corners)):
        with pytest.raises(LinAlgError):
            BlockCholesky(*system)
