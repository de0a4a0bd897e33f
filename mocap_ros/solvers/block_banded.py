"""Symmetric block-tridiagonal systems with a low-rank correction, solved by one banded Cholesky.

The normal matrix of a sequence has one n x n block a frame on its diagonal; blocks coupling neighbouring frames,
diagonal but for their last c x c; and, for unknowns shared by all frames of a person (mean bone lengths), minus a
matrix of low rank. Many people are one such system: the coupling from one to the next is zero.
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
    """Blocks of frame t + 1 (rows) and t (columns).

    Attributes:
        diagonal: (F - 1, n) of the blocks.
        corner: (F - 1, c, c) their last rows and columns, whose diagonals count as well.
    """

    diagonal: Array
    corner: Array

    @property
    def bandwidth(self) -> int:
        """Of the whole matrix."""
        return self.diagonal.shape[1] + self.corner.shape[1] - 1

    def dense(self) -> Array:
        """(F - 1, n, n) the blocks written out."""
        frames, n = self.diagonal.shape
        out = np.zeros((frames, n, n))
        np.einsum('nii->ni', out)[:] = self.diagonal
        c = self.corner.shape[1]
        out[:, n - c :, n - c :] += self.corner
        return out


def band_storage(diagonal: Array, coupling: Coupling) -> Array:
    """LAPACK's lower band storage (bandwidth + 1, F n), in Fortran order; diagonal (F, n, n), symmetric."""
    frames, n, _ = diagonal.shape
    c = coupling.corner.shape[1]
    column = np.zeros((frames, n, 2 * n + c))
    column[:, :, :n] = diagonal  # symmetric: row i is column i
    s0, s1, s2 = column.strides
    band = np.ascontiguousarray(as_strided(column, (frames, n, n + c), (s0, s1 + s2, s2)))
    band[:-1, :, n] = coupling.diagonal
    for i in range(c):
        for j in range(c):
            band[:-1, n - c + j, n + i - j] += coupling.corner[:, i, j]
    return band.reshape(frames * n, n + c).T


@dataclass(frozen=True, eq=False)
class Factor:
    """Cholesky factor of the banded part, in LAPACK's lower band storage."""

    band: Array

    def forward(self, right: Array) -> Array:
        """(F, n, R) right-hand sides -> L^-1 times them."""
        return self._triangular(right, 'N')

    def backward(self, right: Array) -> Array:
        """(F, n, R) -> L^-T times them."""
        return self._triangular(right, 'T')

    def diagonal_block(self, frames: NDArray[np.intp], n: int) -> Array:
        """(P, n, n) blocks of L of these frames (P,)."""
        row, column = np.tril_indices(n)
        out = np.zeros((len(frames), n, n))
        out[:, row, column] = self.band[row - column, frames[:, None] * n + column]
        return out

    def solve(self, right: Array) -> Array:
        """(F, n, R) right-hand sides -> (F, n, R) solutions."""
        return self.backward(self.forward(right))

    def _triangular(self, right: Array, trans: str) -> Array:
        frames, n, count = right.shape
        flat = np.asfortranarray(right.reshape(frames * n, count))
        solution, _ = lapack.dtbtrs(self.band, flat, uplo='L', trans=trans, overwrite_b=1)
        return np.asarray(solution).reshape(frames, n, count)


def factor(diagonal: Array, coupling: Coupling) -> Factor | None:
    """Factor the banded part, or None where it is not positive definite; diagonal (F, n, n)."""
    band, info = lapack.dpbtrf(band_storage(diagonal, coupling), lower=1, overwrite_ab=1)
    return Factor(band) if info == 0 else None


def solve_less_low_rank(
    banded: Factor, right: Array, vectors: Array, strength: Array, starts: NDArray[np.intp]
) -> Array:
    """Solve (banded - sum_p strength_p sum_b g_pb g_pb^T) x = right by Woodbury's identity.

    Args:
        banded: factor of the block-tridiagonal part.
        right: (F, n).
        vectors: (F, n, B) the g_pb cut into frames; person p's are those of its own frames.
        strength: (P,) at least 0.
        starts: (P,) first frame of each person.

    Returns:
        (F, n).
    """
    # with B = L L^T, y = L^-1 r and V = L^-1 G: x = L^-T (y + V (I / s - V^T V)^-1 V^T y), s may be 0
    solved = banded.forward(np.concatenate([right[..., None], vectors], axis=-1))
    y, v = solved[..., :1], solved[..., 1:]
    v_transposed = np.swapaxes(v, -1, -2)
    inner = np.add.reduceat(v_transposed @ v, starts, axis=0)
    pull = np.add.reduceat(v_transposed @ y, starts, axis=0)
    s = strength[:, None, None]
    weight = np.linalg.solve(np.eye(v.shape[-1]) - s * inner, s * pull)
    counts = np.diff(np.append(starts, len(right)))
    return banded.backward(y + v @ np.repeat(weight, counts, axis=0))[..., 0]
