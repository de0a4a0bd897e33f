"""Symmetric block-tridiagonal systems with a low-rank downdate, solved by one banded Cholesky factorisation.

    A x = r,    A = B - G S G^T

This is the form of the normal equations of a sequence of F frames with n unknowns each:

B is positive definite and block tridiagonal: one n x n block for each frame, and blocks between neighbours
that are diagonal except for their last c rows and columns (smoothness of the weights and of the camera). Its
bandwidth is n + c - 1.

G S G^T has low rank: it stands for unknowns that all frames of one person share and that have been eliminated (the
mean bone lengths). Person p has the columns G_p, which are zero outside the frames of p, and S = s_p I.

Several people form one system whose coupling between the last frame of one and the first frame of the next is
zero. With the Cholesky factorisation B = L L^T, y = L^-1 r and V_p = L^-1 G_p, Woodbury's identity

    (B - s G G^T)^-1 = B^-1 + B^-1 G (I / s - G^T B^-1 G)^-1 G^T B^-1

becomes, in a form that also holds for s = 0,

    x = L^-T (y + sum_p V_p (I - s_p V_p^T V_p)^-1 s_p V_p^T y)

LAPACK's routines: `dpbtrf` is the Cholesky factorisation of a positive definite (p) band (b) matrix, `dtbtrs` the
solution of a triangular (t) band (b) system; d is double precision. Both take the lower band storage, in which row
d holds the d-th diagonal below the main one: band[i - j, j] = B[i, j] for j <= i <= j + bandwidth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Coupling:
    """Blocks of the matrix B in the rows of frame t + 1 and the columns of frame t.

    A block is diag(`diagonal`[t]) with `corner`[t] added to its last c rows and columns.

    Attributes:
        diagonal: (F - 1, n) diagonals of the blocks.
        corner: (F - 1, c, c) what is added to the last c rows and columns.
    """

    diagonal: Array
    corner: Array


def pack_lower_band(diagonal: Array, coupling: Coupling) -> Array:
    """Return B in LAPACK's lower band storage.

    Args:
        diagonal: (F, n, n) symmetric diagonal blocks.
        coupling: blocks between neighbouring frames.

    Returns:
        (n + c, F n), in Fortran order.
    """
    frames, n, _ = diagonal.shape
    c = coupling.corner.shape[1]
    column = np.zeros((frames, n, 2 * n + c))
    column[:, :, :n] = diagonal  # each block is symmetric, so its row i is its column i
    # The band begins each column at its diagonal element: a row stride of one row and one element skips the i
    # elements above it.
    s0, s1, s2 = column.strides
    band = np.ascontiguousarray(as_strided(column, (frames, n, n + c), (s0, s1 + s2, s2)))
    band[:-1, :, n] = coupling.diagonal
    for i in range(c):
        for j in range(c):
            band[:-1, n - c + j, n + i - j] += coupling.corner[:, i, j]
    return band.reshape(frames * n, n + c).T


@dataclass(frozen=True, eq=False)
class BandedCholesky:
    """Cholesky factor L of B = L L^T.

    Attributes:
        band: (bandwidth + 1, F n) L in LAPACK's lower band storage.
    """

    band: Array

    def solve_lower(self, right: Array) -> Array:
        """Return L^-1 times the right-hand sides, (F, n, R) for R of them."""
        return self._solve_triangular(right, 'N')

    def solve_lower_transposed(self, right: Array) -> Array:
        """Return L^-T times the right-hand sides, (F, n, R) for R of them."""
        return self._solve_triangular(right, 'T')

    def solve(self, right: Array) -> Array:
        """Return B^-1 times the right-hand sides, (F, n, R) for R of them."""
        return self.solve_lower_transposed(self.solve_lower(right))

    def diagonal_blocks(self, frames: NDArray[np.intp], n: int) -> Array:
        """Return the diagonal blocks (P, n, n) of L of the given frames (P,)."""
        row, column = np.tril_indices(n)
        out = np.zeros((len(frames), n, n))
        out[:, row, column] = self.band[row - column, frames[:, None] * n + column]
        return out

    def _solve_triangular(self, right: Array, trans: str) -> Array:
        """Solve with L (`trans` 'N') or L^T ('T')."""
        frames, n, count = right.shape
        flat = np.asfortranarray(right.reshape(frames * n, count))
        solution, _ = lapack.dtbtrs(self.band, flat, uplo='L', trans=trans, overwrite_b=1)
        return np.asarray(solution).reshape(frames, n, count)


def factorise_banded(diagonal: Array, coupling: Coupling) -> BandedCholesky | None:
    """Return the Cholesky factor of B, or None if B is not positive definite.

    Args:
        diagonal: (F, n, n) symmetric diagonal blocks.
        coupling: blocks between neighbouring frames.
    """
    band, info = lapack.dpbtrf(pack_lower_band(diagonal, coupling), lower=1, overwrite_ab=1)
    return BandedCholesky(band) if info == 0 else None


def solve_low_rank_downdate(
    banded: BandedCholesky, right: Array, vectors: Array, strength: Array, starts: NDArray[np.intp]
) -> Array:
    """Solve (B - sum_p s_p G_p G_p^T) x = r by Woodbury's identity (head of this module).

    Args:
        banded: Cholesky factor of B.
        right: (F, n) right-hand side r.
        vectors: (F, n, R) rows of the matrices G_p, one after the other: each frame has those of its own person.
        strength: (P,) factors s_p, at least 0.
        starts: (P,) first frame of each person.

    Returns:
        The solution x, (F, n).
    """
    solved = banded.solve_lower(np.concatenate([right[..., None], vectors], axis=-1))
    y, v = solved[..., :1], solved[..., 1:]
    v_transposed = np.swapaxes(v, -1, -2)
    v_squared = np.add.reduceat(v_transposed @ v, starts, axis=0)  # (P, R, R): V_p^T V_p
    v_right = np.add.reduceat(v_transposed @ y, starts, axis=0)  # (P, R, 1): V_p^T y
    s = strength[:, None, None]
    correction = np.linalg.solve(np.eye(v.shape[-1]) - s * v_squared, s * v_right)
    counts = np.diff(np.append(starts, len(right)))
    return banded.solve_lower_transposed(y + v @ np.repeat(correction, counts, axis=0))[..., 0]
