# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The block Cholesky factorisation against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve

from mocap_ros.solvers.block_banded import Coupling, factorise_blocks, solve_damped
from tests.support.dense_matrices import make_dense_coupling

FRAMES, UNKNOWNS, CORNER, VECTORS = 7, 5, 2, 3
STARTS, COUNTS = np.array([0, 4]), np.array([4, 3])


def make_system(rng: np.random.Generator, distances: int) -> tuple[np.ndarray, Coupling, np.ndarray]:
    """Diagonal blocks, coupling and the dense matrix of two sequences that are not coupled with each other."""
    a = rng.normal(size=(FRAMES, UNKNOWNS, UNKNOWNS))
    diagonal = a @ np.swapaxes(a, 1, 2) + 20 * np.eye(UNKNOWNS)
    coupling = Coupling(
        rng.normal(size=(distances, FRAMES, UNKNOWNS)), rng.normal(size=(distances, FRAMES, CORNER, CORNER))
    )
    dense = np.zeros((FRAMES, UNKNOWNS, FRAMES, UNKNOWNS))
    for t in range(FRAMES):
        dense[t, :, t] = diagonal[t]
    for d in range(1, distances + 1):
        seam = slice(STARTS[1] - d, STARTS[1])
        coupling.diagonal[d - 1, seam] = 0
        coupling.corner[d - 1, seam] = 0
        for t, block in enumerate(make_dense_coupling(coupling, d)):
            dense[t + d, :, t] = block
            dense[t, :, t + d] = block.T
    return diagonal, coupling, dense


def as_matrix(dense: np.ndarray) -> np.ndarray:
    return dense.reshape(FRAMES * UNKNOWNS, FRAMES * UNKNOWNS)


@pytest.mark.parametrize('distances', [1, 2, 3])
def test_solution_equals_the_dense_one(rng: np.random.Generator, distances: int) -> None:
    diagonal, coupling, dense = make_system(rng, distances)
    right = rng.normal(size=(FRAMES, UNKNOWNS, 4))
    factor = factorise_blocks(diagonal, coupling)
    assert factor is not None
    expected = solve(as_matrix(dense), right.reshape(-1, 4)).reshape(right.shape)
    assert factor.solve(right) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert factor.solve_lower_transposed(factor.solve_lower(right)) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert factor.log_determinant() == pytest.approx(np.linalg.slogdet(as_matrix(dense))[1], rel=1e-12)


@pytest.mark.parametrize('distances', [1, 2])
def test_low_rank_downdate_of_each_sequence_equals_the_dense_solution(
    rng: np.random.Generator, distances: int
) -> None:
    diagonal, coupling, dense = make_system(rng, distances)
    vectors, right = rng.normal(size=(FRAMES, UNKNOWNS, VECTORS)), rng.normal(size=(FRAMES, UNKNOWNS))
    strength = np.array([0.2, 0.0])
    for s, start, count in zip(strength, STARTS, COUNTS, strict=True):
        own = slice(start, start + count)
        dense[own, :, own] -= s * np.einsum('tib,ujb->tiuj', vectors[own], vectors[own])
    damping, is_free = np.array([0.0, 0.5]), np.ones(FRAMES, bool)
    for p, start in enumerate(STARTS):
        for t in range(start, start + COUNTS[p]):
            dense[t, :, t] += damping[p] * np.diag(np.diag(diagonal[t]))
    system = diagonal, coupling, right, vectors
    found = solve_damped(*system, strength, damping, is_free, STARTS, COUNTS)
    assert found is not None
    assert found.solution.ravel() == pytest.approx(solve(as_matrix(dense), right.ravel()), rel=1e-9)
    without_vectors = solve_damped(*system, 0 * strength, 0 * damping, is_free, STARTS, COUNTS)
    factor = factorise_blocks(diagonal.copy(), coupling)
    assert factor is not None
    assert without_vectors is not None
    assert without_vectors.last_inverse == pytest.approx(factor.inverse[STARTS + COUNTS - 1], rel=1e-9)
    too_strong = np.array([100.0, 0.0])
    assert solve_damped(*system, too_strong, damping, is_free, STARTS, COUNTS) is None


@pytest.mark.parametrize('distances', [1, 2])
def test_frames_that_are_held_do_not_move(rng: np.random.Generator, distances: int) -> None:
    diagonal, coupling, dense = make_system(rng, distances)
    is_free = np.array([False, True, True, False, False, True, True])
    right, vectors = rng.normal(size=(FRAMES, UNKNOWNS)), rng.normal(size=(FRAMES, UNKNOWNS, VECTORS))
    strength = np.array([0.1, 0.3])
    for s, start, count in zip(strength, STARTS, COUNTS, strict=True):
        own = slice(start, start + count)
        dense[own, :, own] -= s * np.einsum('tib,ujb->tiuj', vectors[own], vectors[own])
    free = np.repeat(is_free, UNKNOWNS)
    expected = np.zeros(FRAMES * UNKNOWNS)
    expected[free] = solve(as_matrix(dense)[np.ix_(free, free)], right.ravel()[free])
    found = solve_damped(diagonal, coupling, right, vectors, strength, np.zeros(2), is_free, STARTS, COUNTS)
    assert found is not None
    assert found.solution.ravel() == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_a_matrix_that_is_not_positive_definite_has_no_factor(rng: np.random.Generator) -> None:
    diagonal, coupling, _ = make_system(rng, 1)
    assert factorise_blocks(-diagonal, coupling) is None
    strong = Coupling(100 * coupling.diagonal, coupling.corner)
    assert factorise_blocks(diagonal, strong) is None
