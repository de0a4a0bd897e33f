# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""BLAS and LAPACK for kernels: the few routines that the solvers need, on C-contiguous matrices, in place.

The routines are those that SciPy was linked with. Compiled code refers to them by name, so it can be cached, and
the names are bound to addresses when this module is imported. Uncompiled, the functions call SciPy.

BLAS takes matrices column by column. A C-contiguous matrix, read so, is its transpose; every function says what it
computes of the matrices as NumPy shows them.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
import numpy as np
import scipy.linalg
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import get_cython_function_address, intrinsic, overload
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CHAR = types.CPointer(types.uint8)
_INT = types.CPointer(types.int32)
_FLOAT = types.CPointer(types.float64)

# Letters by which the routines are told what to do.
_UPPER, _NO, _TRANSPOSED, _RIGHT = ord('U'), ord('N'), ord('T'), ord('R')


def _bind(library: str, routine: str, *arguments: Any) -> Any:
    """Return a Fortran routine of `scipy.linalg.cython_blas` or `cython_lapack` as Numba calls it."""
    symbol = f'mocap_ros_{routine}'
    llvm.add_symbol(symbol, get_cython_function_address(f'scipy.linalg.cython_{library}', routine))
    return types.ExternalFunction(symbol, types.void(*arguments))


_dpotrf = _bind('lapack', 'dpotrf', _CHAR, _INT, _FLOAT, _INT, _INT)
_dtrsm = _bind('blas', 'dtrsm', *[_CHAR] * 4, _INT, _INT, _FLOAT, _FLOAT, _INT, _FLOAT, _INT)
_dgemm = _bind(
    'blas', 'dgemm', _CHAR, _CHAR, _INT, _INT, _INT, _FLOAT, _FLOAT, _INT, _FLOAT, _INT, _FLOAT, _FLOAT, _INT
)


@intrinsic
def _by_reference(_typing: Any, value: Any) -> Any:
    """Return the address of a copy of a number; Fortran takes all arguments by reference."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return cgutils.alloca_once_value(builder, arguments[0])

    return types.CPointer(value)(value), generate


@intrinsic
def _value(_typing: Any, address: Any) -> Any:
    """Return the number at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.load(arguments[0])

    return address.dtype(address), generate


@intrinsic
def _first(_typing: Any, array: Any) -> Any:
    """Return the address of the first element of an array."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), generate


def _require_matrices(*arrays: Any) -> None:
    """Check the types of matrices when a kernel is compiled, because the routines see nothing but addresses.

    Raises:
        TypingError: One is not a C-contiguous matrix of float64.
    """
    for array in arrays:
        if not (isinstance(array, types.Array) and array.ndim == 2 and array.layout == 'C'):
            raise TypingError(f'expected a C-contiguous matrix, got {array}')
        if array.dtype != types.float64:
            raise TypingError(f'expected a matrix of float64, got {array}')


def factorise_cholesky(matrix: Array) -> bool:
    """Overwrite the lower triangle of a symmetric matrix A (n, n) with the factor L of A = L L^T.

    Only the lower triangle is read; the upper one stays as it is.

    Returns:
        False if the matrix is not positive definite; then the triangle holds nothing of use. A matrix with NaN may
        pass, and then the factor has NaN.
    """
    factor, info = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=0)
    matrix[:] = factor
    return bool(info == 0)


@overload(factorise_cholesky)
def _compile_factorise_cholesky(matrix: Any) -> Any:
    _require_matrices(matrix)

    def implementation(matrix: Any) -> Any:
        n = np.int32(matrix.shape[0])
        info = _by_reference(np.int32(0))
        _dpotrf(
            _by_reference(np.uint8(_UPPER)),
            _by_reference(n),
            _first(matrix),
            _by_reference(np.int32(max(n, 1))),
            info,
        )
        return _value(info) == 0

    return implementation


def solve_lower(factor: Array, right: Array) -> None:
    """Overwrite B (n, R) with L^-1 B, L the lower triangle of `factor` (n, n)."""
    right[:] = scipy.linalg.solve_triangular(factor, right, lower=True, check_finite=False)


@overload(solve_lower)
def _compile_solve_lower(factor: Any, right: Any) -> Any:
    _require_matrices(factor, right)

    def implementation(factor: Any, right: Any) -> None:
        _solve_triangular(_NO, factor, right)

    return implementation


def solve_lower_transposed(factor: Array, right: Array) -> None:
    """Overwrite B (n, R) with L^-T B, L the lower triangle of `factor` (n, n)."""
    right[:] = scipy.linalg.solve_triangular(factor, right, lower=True, trans=1, check_finite=False)


@overload(solve_lower_transposed)
def _compile_solve_lower_transposed(factor: Any, right: Any) -> Any:
    _require_matrices(factor, right)

    def implementation(factor: Any, right: Any) -> None:
        _solve_triangular(_TRANSPOSED, factor, right)

    return implementation


def _solve_triangular(trans: int, factor: Array, right: Array) -> None:
    """Overwrite B with op(L)^-1 B."""
    raise NotImplementedError  # only kernels call it


@overload(_solve_triangular)
def _compile_solve_triangular(trans: Any, factor: Any, right: Any) -> Any:
    def implementation(trans: Any, factor: Any, right: Any) -> None:
        if right.shape[0] == 0 or right.shape[1] == 0:
            return
        # The routine sees the transposes of both matrices, and (L^-1 B)^T = B^T L^-T: the factor is on the right.
        _dtrsm(
            _by_reference(np.uint8(_RIGHT)),
            _by_reference(np.uint8(_UPPER)),
            _by_reference(np.uint8(trans)),
            _by_reference(np.uint8(_NO)),
            _by_reference(np.int32(right.shape[1])),
            _by_reference(np.int32(right.shape[0])),
            _by_reference(1.0),
            _first(factor),
            _by_reference(np.int32(factor.shape[1])),
            _first(right),
            _by_reference(np.int32(right.shape[1])),
        )

    return implementation


def add_product(factor: float, a: Array, b: Array, out: Array) -> None:
    """Add f A B to C in place: A (m, k), B (k, n), C (m, n)."""
    out += factor * (a @ b)


@overload(add_product)
def _compile_add_product(factor: Any, a: Any, b: Any, out: Any) -> Any:
    _require_matrices(a, b, out)

    def implementation(factor: Any, a: Any, b: Any, out: Any) -> None:
        _multiply(_NO, _NO, a.shape[1], factor, a, b, out)

    return implementation


def add_transposed_product(factor: float, a: Array, b: Array, out: Array) -> None:
    """Add f A^T B to C in place: A (k, m), B (k, n), C (m, n)."""
    out += factor * (a.T @ b)


@overload(add_transposed_product)
def _compile_add_transposed_product(factor: Any, a: Any, b: Any, out: Any) -> Any:
    _require_matrices(a, b, out)

    def implementation(factor: Any, a: Any, b: Any, out: Any) -> None:
        _multiply(_TRANSPOSED, _NO, a.shape[0], factor, a, b, out)

    return implementation


def add_product_transposed(factor: float, a: Array, b: Array, out: Array) -> None:
    """Add f A B^T to C in place: A (m, k), B (n, k), C (m, n)."""
    out += factor * (a @ b.T)


@overload(add_product_transposed)
def _compile_add_product_transposed(factor: Any, a: Any, b: Any, out: Any) -> Any:
    _require_matrices(a, b, out)

    def implementation(factor: Any, a: Any, b: Any, out: Any) -> None:
        _multiply(_NO, _TRANSPOSED, a.shape[1], factor, a, b, out)

    return implementation


def _multiply(trans_a: int, trans_b: int, inner: int, factor: float, a: Array, b: Array, out: Array) -> None:
    """Add f op(A) op(B) to C; `inner` is the length of the sums."""
    raise NotImplementedError  # only kernels call it


@overload(_multiply)
def _compile_multiply(trans_a: Any, trans_b: Any, inner: Any, factor: Any, a: Any, b: Any, out: Any) -> Any:
    def implementation(trans_a: Any, trans_b: Any, inner: Any, factor: Any, a: Any, b: Any, out: Any) -> None:
        if out.shape[0] == 0 or out.shape[1] == 0 or inner == 0:
            return
        # The routine sees the transposes of all matrices, and (A B)^T = B^T A^T.
        _dgemm(
            _by_reference(np.uint8(trans_b)),
            _by_reference(np.uint8(trans_a)),
            _by_reference(np.int32(out.shape[1])),
            _by_reference(np.int32(out.shape[0])),
            _by_reference(np.int32(inner)),
            _by_reference(float(factor)),
            _first(b),
            _by_reference(np.int32(b.shape[1])),
            _first(a),
            _by_reference(np.int32(a.shape[1])),
            _by_reference(1.0),
            _first(out),
            _by_reference(np.int32(out.shape[1])),
        )

    return implementation
