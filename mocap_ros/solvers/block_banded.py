"""Symmetric block-banded systems with a low-rank downdate, solved by one block Cholesky factorisation.

    A x = r,    A = B - G S G^T

This is the form of the normal equations of a sequence of F frames with n unknowns each:

B is positive definite, with one n x n block for each frame and blocks between a frame and the next D frames (D is
1 for velocities, 2 for accelerations). These are diagonal except for their last c rows and columns (smoothness of
the weights and of the camera).

G S G^T has low rank: it stands for unknowns that all frames of one person share and that have been eliminated (the
mean bone lengths). Person p has the columns G_p, which are zero outside the frames of p, and S = s_p I.

Several people form one system whose coupling between the frames of two of them is zero. The factorisation
B = L L^T goes frame by frame; with the blocks B_ut in the rows of frame u and the columns of frame t,

    L_tt L_tt^T = B_tt,    L_ut = B_ut L_tt^-T  for u = t + 1 ... t + D,    then  B_uv <- B_uv - L_ut L_vt^T

for all u >= v > t. With y = L^-1 r and V_p = L^-1 G_p, Woodbury's identity

    (B - s G G^T)^-1 = B^-1 + B^-1 G (I / s - G^T B^-1 G)^-1 G^T B^-1

becomes, in a form that also holds for s = 0,

    x = L^-T (y + sum_p V_p (I - s_p V_p^T V_p)^-1 s_p V_p^T y)

Some frames may be held: their unknowns keep their values, so that x is 0 there and the rows and columns of these
frames are left out of the system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.blas import (
    add_product,
    add_product_transposed,
    add_transposed_product,
    divide_by_lower_transposed,
    factorise_cholesky,
    solve_lower,
    solve_lower_transposed,
)
from mocap_ros.compiled.kernel import (
    BOOL,
    BOOLS_1D,
    BOOLS_2D,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    FLOATS_4D,
    INT,
    INTS_1D,
    kernel,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Coupling:
    """Blocks of the matrix B in the rows of frame t + d and the columns of frame t, for d = 1 ... D.

    A block is diag(`diagonal`[d - 1, t]) with `corner`[d - 1, t] added to its last c rows and columns. Blocks of
    frames that have no d-th next frame are ignored.

    Attributes:
        diagonal: (D, F, n) diagonals of the blocks.
        corner: (D, F, c, c) what is added to the last c rows and columns.
    """

    diagonal: Array
    corner: Array

    @staticmethod
    def zeros(distances: int, frames: int, unknowns: int, corner: int) -> Coupling:
        """Return blocks that couple nothing, for D `distances`, F `frames`, n `unknowns` and c `corner`."""
        return Coupling(np.zeros((distances, frames, unknowns)), np.zeros((distances, frames, corner, corner)))


@dataclass(frozen=True, eq=False)
class BlockCholesky:
    """Cholesky factor L of B = L L^T.

    Attributes:
        diagonal: (F, n, n) blocks L_tt in the lower triangles; the upper ones hold nothing of use.
        below: (D, F, n, n) blocks of L in the rows of frame t + d and the columns of frame t, at [d - 1, t].
        is_coupled: (D, F) whether these blocks are not 0.
        is_free: (F,) False for frames that are held.
    """

    diagonal: Array
    below: Array
    is_coupled: NDArray[np.bool_]
    is_free: NDArray[np.bool_]

    def solve(self, right: Array) -> Array:
        """Return B^-1 times the right-hand sides, (F, n, R) for R of them; 0 in frames that are held."""
        solution = right.copy()
        solve_forward(self.diagonal, self.below, self.is_coupled, self.is_free, solution)
        solve_backward(self.diagonal, self.below, self.is_coupled, self.is_free, solution)
        return solution

    def solve_lower(self, right: Array) -> Array:
        """Return L^-1 times the right-hand sides, (F, n, R) for R of them; 0 in frames that are held."""
        solution = right.copy()
        solve_forward(self.diagonal, self.below, self.is_coupled, self.is_free, solution)
        return solution

    def solve_lower_transposed(self, right: Array) -> Array:
        """Return L^-T times the right-hand sides, (F, n, R) for R of them; 0 in frames that are held."""
        solution = right.copy()
        solve_backward(self.diagonal, self.below, self.is_coupled, self.is_free, solution)
        return solution

    def log_determinant(self) -> float:
        """Return log det B of the frames that are not held."""
        on_diagonal = np.einsum('fii->fi', self.diagonal)[self.is_free]
        return float(2 * np.log(on_diagonal).sum())


def factorise_blocks(
    diagonal: Array, coupling: Coupling, is_free: NDArray[np.bool_] | None = None
) -> BlockCholesky | None:
    """Return the Cholesky factor of B, or None if B is not positive definite.

    Args:
        diagonal: (F, n, n) symmetric diagonal blocks; they are overwritten.
        coupling: blocks between frames.
        is_free: (F,) False for frames that are held; None if none is.
    """
    if is_free is None:
        is_free = np.ones(len(diagonal), bool)
    is_definite, below, is_coupled = _factorise(diagonal, coupling.diagonal, coupling.corner, is_free)
    return BlockCholesky(diagonal, below, is_coupled, is_free) if is_definite else None


def solve_low_rank_downdate(
    factor: BlockCholesky,
    right: Array,
    vectors: Array,
    strength: Array,
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> Array | None:
    """Solve (B - sum_p s_p G_p G_p^T) x = r by Woodbury's identity (head of this module).

    Args:
        factor: Cholesky factor of B.
        right: (F, n) right-hand side r.
        vectors: (F, n, R) rows of the matrices G_p, one after the other: each frame has those of its own person.
        strength: (P,) factors s_p, at least 0.
        starts: (P,) first frame of each person.
        counts: (P,) number of frames of each person.

    Returns:
        The solution x, (F, n); None if the matrix is not positive definite.
    """
    is_definite, solution = _solve_downdate(
        factor.diagonal,
        factor.below,
        factor.is_coupled,
        factor.is_free,
        right,
        vectors,
        strength,
        starts,
        counts,
    )
    return solution if is_definite else None


@kernel(BOOL(FLOATS_1D, FLOATS_2D, FLOATS_2D))
def _add_coupling(diagonal: Array, corner: Array, block: Array) -> bool:
    """Add one block of a `Coupling` to a matrix (n, n), and return whether the block is not 0."""
    n, c = len(diagonal), len(corner)
    is_coupled = False
    for i in range(n):
        is_coupled |= diagonal[i] != 0.0
        block[i, i] += diagonal[i]
    for i in range(c):
        for j in range(c):
            is_coupled |= corner[i, j] != 0.0
            block[n - c + i, n - c + j] += corner[i, j]
    return is_coupled


@kernel(void(INT, FLOATS_3D, FLOATS_4D, BOOLS_2D))
def _eliminate(t: int, lower: Array, below: Array, is_coupled: NDArray[np.bool_]) -> None:
    """Subtract L_ut L_vt^T from the blocks of all pairs of later frames u >= v with which frame t is coupled."""
    distances, frames = is_coupled.shape
    for d in range(min(distances, frames - 1 - t)):
        if not is_coupled[d, t]:
            continue
        add_product_transposed(-1.0, below[d, t], below[d, t], lower[t + d + 1])
        for e in range(d):
            if is_coupled[e, t]:
                add_product_transposed(-1.0, below[d, t], below[e, t], below[d - e - 1, t + e + 1])
                is_coupled[d - e - 1, t + e + 1] = True


@kernel(types.Tuple((BOOL, FLOATS_4D, BOOLS_2D))(FLOATS_3D, FLOATS_3D, FLOATS_4D, BOOLS_1D))
def _factorise(
    lower: Array, coupling_diagonal: Array, coupling_corner: Array, is_free: NDArray[np.bool_]
) -> tuple[bool, Array, NDArray[np.bool_]]:
    """Overwrite the diagonal blocks with those of L.

    Returns:
        Whether the matrix is positive definite, and `below` and `is_coupled` of the `BlockCholesky`.
    """
    distances, frames, n = coupling_diagonal.shape
    below = np.zeros((distances, frames, n, n))
    is_coupled = np.zeros((distances, frames), np.bool_)
    for t in range(frames):
        if not is_free[t]:
            continue
        if not factorise_cholesky(lower[t]):
            return False, below, is_coupled
        for d in range(min(distances, frames - 1 - t)):
            if not is_free[t + d + 1]:
                is_coupled[d, t] = False
                continue
            if _add_coupling(coupling_diagonal[d, t], coupling_corner[d, t], below[d, t]):
                is_coupled[d, t] = True
            if is_coupled[d, t]:
                divide_by_lower_transposed(below[d, t], lower[t])
        _eliminate(t, lower, below, is_coupled)
    return True, below, is_coupled


@kernel(void(FLOATS_3D, FLOATS_4D, BOOLS_2D, BOOLS_1D, FLOATS_3D))
def solve_forward(
    diagonal: Array, below: Array, is_coupled: NDArray[np.bool_], is_free: NDArray[np.bool_], right: Array
) -> None:
    """Overwrite right-hand sides (F, n, R) with L^-1 times them; the factor is that of a `BlockCholesky`."""
    distances, frames = is_coupled.shape
    for t in range(frames):
        if not is_free[t]:
            right[t] = 0.0
            continue
        solve_lower(diagonal[t], right[t])
        for d in range(min(distances, frames - 1 - t)):
            if is_coupled[d, t]:
                add_product(-1.0, below[d, t], right[t], right[t + d + 1])


@kernel(void(FLOATS_3D, FLOATS_4D, BOOLS_2D, BOOLS_1D, FLOATS_3D))
def solve_backward(
    diagonal: Array, below: Array, is_coupled: NDArray[np.bool_], is_free: NDArray[np.bool_], right: Array
) -> None:
    """Overwrite right-hand sides (F, n, R) with L^-T times them; the factor is that of a `BlockCholesky`."""
    distances, frames = is_coupled.shape
    for t in range(frames - 1, -1, -1):
        if not is_free[t]:
            right[t] = 0.0
            continue
        for d in range(min(distances, frames - 1 - t)):
            if is_coupled[d, t]:
                add_transposed_product(-1.0, below[d, t], right[t + d + 1], right[t])
        solve_lower_transposed(diagonal[t], right[t])


@kernel(
    types.Tuple((BOOL, FLOATS_2D))(
        FLOATS_3D, FLOATS_4D, BOOLS_2D, BOOLS_1D, FLOATS_2D, FLOATS_3D, FLOATS_1D, INTS_1D, INTS_1D
    )
)
def _solve_downdate(
    diagonal: Array,
    below: Array,
    is_coupled: NDArray[np.bool_],
    is_free: NDArray[np.bool_],
    right: Array,
    vectors: Array,
    strength: Array,
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> tuple[bool, Array]:
    """Return whether the downdated matrix is positive definite, and the solution (F, n)."""
    frames, n, size = len(vectors), vectors.shape[1], 1 + vectors.shape[2]
    solved = np.empty((frames, n, size))
    solved[:, :, 0] = right
    solved[:, :, 1:] = vectors
    solution = np.empty((frames, n, 1))
    solve_forward(diagonal, below, is_coupled, is_free, solved)
    for p in range(len(starts)):
        first, end = starts[p], starts[p] + counts[p]
        squares = np.zeros((size, size))  # of (y, V): y^T y, V^T y and V^T V
        for t in range(first, end):
            if is_free[t]:
                add_transposed_product(1.0, solved[t], solved[t], squares)
        reduced = np.empty((size - 1, size - 1))
        correction = np.empty((size - 1, 1))
        for i in range(size - 1):
            for j in range(size - 1):
                reduced[i, j] = -strength[p] * squares[1 + i, 1 + j]
            reduced[i, i] += 1.0
            correction[i, 0] = strength[p] * squares[1 + i, 0]
        if not factorise_cholesky(reduced):
            return False, right
        solve_lower(reduced, correction)
        solve_lower_transposed(reduced, correction)
        for t in range(first, end):
            for i in range(n):
                total = solved[t, i, 0]
                for j in range(size - 1):
                    total += solved[t, i, 1 + j] * correction[j, 0]
                solution[t, i, 0] = total
    solve_backward(diagonal, below, is_coupled, is_free, solution)
    return True, solution.reshape((frames, n))
