# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every routine inside a kernel and uncompiled, against plain NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba import void
from numba.core.errors import TypingError
from numpy.typing import NDArray

from mocap_ros.compiled import blas
from mocap_ros.compiled.kernel import BOOL, FLOAT, FLOATS_2D, FLOATS_3D, compile_kernels, kernel

Array = NDArray[np.float64]


@kernel(BOOL(FLOATS_2D))
def factorise_cholesky(matrix: Array) -> bool:
    return blas.factorise_cholesky(matrix)


@kernel(void(FLOATS_2D, FLOATS_2D))
def solve_lower(factor: Array, right: Array) -> None:
    blas.solve_lower(factor, right)


@kernel(void(FLOATS_2D, FLOATS_2D))
def solve_lower_transposed(factor: Array, right: Array) -> None:
    blas.solve_lower_transposed(factor, right)


@kernel(void(FLOAT, FLOATS_2D, FLOATS_2D, FLOATS_2D))
def add_product(factor: float, a: Array, b: Array, out: Array) -> None:
    blas.add_product(factor, a, b, out)


@kernel(void(FLOAT, FLOATS_2D, FLOATS_2D, FLOATS_2D))
def add_transposed_product(factor: float, a: Array, b: Array, out: Array) -> None:
    blas.add_transposed_product(factor, a, b, out)


@kernel(void(FLOAT, FLOATS_2D, FLOATS_2D, FLOATS_2D))
def add_product_transposed(factor: float, a: Array, b: Array, out: Array) -> None:
    blas.add_product_transposed(factor, a, b, out)


@kernel(BOOL(FLOATS_3D, FLOATS_2D))
def solve_last_block(blocks: Array, right: Array) -> bool:
    """Solve with the last of several matrices, so the routines get the address of a part of an array."""
    is_definite = blas.factorise_cholesky(blocks[-1])
    blas.solve_lower(blocks[-1], right)
    blas.solve_lower_transposed(blocks[-1], right)
    return is_definite


compiled_and_not = pytest.mark.parametrize('is_compiled', [True, False], ids=['compiled', 'uncompiled'])
SIZES = [1, 2, 3, 7, 44]


def choose(function: Any, is_compiled: bool) -> Callable[..., Any]:
    """Return a kernel of this module, or the function of `blas` that it calls."""
    return function if is_compiled else getattr(blas, function.__name__)


def make_definite(rng: np.random.Generator, n: int) -> Array:
    root = rng.normal(size=(n, n + 3))
    return root @ root.T + np.eye(n)


def spoil_upper(factor: NDArray[np.floating[Any]]) -> Array:
    """Return a lower triangle with something else above it, which no routine may read."""
    return np.tril(factor) + np.triu(np.full_like(factor, np.nan), 1)


@compiled_and_not
@pytest.mark.parametrize('n', SIZES)
def test_cholesky_factorises_the_lower_triangle_and_leaves_the_upper(
    rng: np.random.Generator, n: int, is_compiled: bool
) -> None:
    matrix = make_definite(rng, n)
    given = spoil_upper(matrix)
    assert choose(factorise_cholesky, is_compiled)(given)
    np.testing.assert_allclose(np.tril(given), np.linalg.cholesky(matrix), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(np.triu(given, 1), np.triu(spoil_upper(matrix), 1))


@compiled_and_not
@pytest.mark.parametrize('diagonal', [[1.0, -1.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, -1e-30]])
def test_cholesky_reports_a_matrix_that_is_not_positive_definite(diagonal: list[float], is_compiled: bool) -> None:
    assert not choose(factorise_cholesky, is_compiled)(np.diag(diagonal))


@compiled_and_not
@pytest.mark.parametrize('columns', [0, 1, 5])
@pytest.mark.parametrize('n', SIZES)
def test_triangular_systems(rng: np.random.Generator, n: int, columns: int, is_compiled: bool) -> None:
    factor = np.linalg.cholesky(make_definite(rng, n))
    right = rng.normal(size=(n, columns))
    for function, matrix in ((solve_lower, factor), (solve_lower_transposed, factor.T)):
        solved = right.copy()
        choose(function, is_compiled)(spoil_upper(factor), solved)
        np.testing.assert_allclose(matrix @ solved, right, rtol=1e-10, atol=1e-10)


@compiled_and_not
@pytest.mark.parametrize('shape', [(1, 1, 1), (3, 2, 5), (7, 1, 4), (45, 44, 3), (2, 0, 3), (0, 2, 3), (2, 3, 0)])
def test_products_are_added(rng: np.random.Generator, shape: tuple[int, int, int], is_compiled: bool) -> None:
    m, k, n = shape
    a, b, before = rng.normal(size=(m, k)), rng.normal(size=(k, n)), rng.normal(size=(m, n))
    expected = before - 0.7 * (a @ b)
    arguments = {
        add_product: (a, b),
        add_transposed_product: (np.ascontiguousarray(a.T), b),
        add_product_transposed: (a, np.ascontiguousarray(b.T)),
    }
    for function, matrices in arguments.items():
        out = before.copy()
        choose(function, is_compiled)(-0.7, *matrices, out)
        np.testing.assert_allclose(out, expected, rtol=1e-12, atol=1e-12)


def test_a_block_of_a_larger_array_is_factorised_in_place(rng: np.random.Generator) -> None:
    matrix, right = make_definite(rng, 6), rng.normal(size=(6, 2))
    blocks = np.stack([np.zeros((6, 6)), np.zeros((6, 6)), matrix])
    solved = right.copy()
    assert solve_last_block(blocks, solved)
    np.testing.assert_allclose(matrix @ solved, right, atol=1e-10)
    assert not blocks[:2].any()


def test_a_kernel_that_hands_over_a_part_of_a_matrix_cannot_be_compiled() -> None:
    @kernel(void(FLOATS_2D, FLOATS_2D))
    def solve_columns(factor: Array, right: Array) -> None:
        blas.solve_lower(factor, right[:, :2])

    from mocap_ros.compiled import kernel as module

    declared = module._pending[-1]
    try:
        with pytest.raises(TypingError, match='expected a C-contiguous matrix'):
            compile_kernels()
    finally:
        module._pending.remove(declared)
