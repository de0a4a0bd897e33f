# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

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

for all u >= v > t. The inverses X_t = L_tt^-1 are formed, since for blocks of this size products are two to three
times as fast as triangular solutions, and since B_ut X_t^T costs next to nothing where B_ut is almost diagonal.
With y = L^-1 r and V_p = L^-1 G_p, Woodbury's identity

    (B - s G G^T)^-1 = B^-1 + B^-1 G (I / s - G^T B^-1 G)^-1 G^T B^-1

becomes, in a form that also holds for s = 0,

    x = L^-T (y + sum_p V_p (I - s_p V_p^T V_p)^-1 s_p V_p^T y)

Some frames may be held: their unknowns keep their values, so that x is 0 there and the rows and columns of these
frames are left out of the system.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.blas import (
    add_product,
    add_product_transposed,
    add_transposed_product,
    factorise_cholesky,
    solve_lower,
    solve_lower_transposed,
)
from mocap_ros.compiled.kernel import (
    BOOL,
    BOOLS_1D,
    BOOLS_2D,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    FLOATS_4D,
    INT,
    INTS_1D,
    kernel,
)

Array = NDArray[np.float64]

MIN_DIAGONAL = 1e-12  # added to the diagonal, for unknowns on which nothing depends (a frame without seen joints)


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
        inverse: (F, n, n) inverses X_t of the diagonal blocks L_tt, with 0 above the diagonal.
        below: (D, F, n, n) blocks of L in the rows of frame t + d and the columns of frame t, at [d - 1, t].
        is_coupled: (D, F) whether these blocks are not 0.
        is_free: (F,) False for frames that are held.
    """

    inverse: Array
    below: Array
    is_coupled: NDArray[np.bool_]
    is_free: NDArray[np.bool_]

    def solve(self, right: Array) -> Array:
        """Return B^-1 times the right-hand sides, (F, n, R) for R of them; 0 in frames that are held."""
        return self.solve_lower_transposed(self.solve_lower(right))

    def solve_lower(self, right: Array) -> Array:
        """Return L^-1 times the right-hand sides, (F, n, R) for R of them; 0 in frames that are held."""
        return _solve_forward(self.inverse, self.below, self.is_coupled, self.is_free, right)

    def solve_lower_transposed(self, right: Array) -> Array:
        """Return L^-T times the right-hand sides, (F, n, R) for R of them; 0 in frames that are held."""
        return _solve_backward(self.inverse, self.below, self.is_coupled, self.is_free, right)

    def log_determinant(self) -> float:
        """Return log det B of the frames that are not held."""
        on_diagonal = np.einsum('fii->fi', self.inverse)[self.is_free]
        return float(-2 * np.log(on_diagonal).sum())


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
    is_definite, inverse, below, is_coupled = _factorise(diagonal, coupling.diagonal, coupling.corner, is_free)
    return BlockCholesky(inverse, below, is_coupled, is_free) if is_definite else None


class DampedSolution(NamedTuple):
    """The solution of a damped system of several people.

    Attributes:
        solution: (F, n).
        last_inverse: (P, n, n) inverse X of the last diagonal block of L of each person. X^T X is the last
            diagonal block of B^-1: the covariance of the last frame's unknowns, damped and without the low-rank
            part.
    """

    solution: Array
    last_inverse: Array


def solve_damped(
    diagonal: Array,
    coupling: Coupling,
    right: Array,
    vectors: Array,
    strength: Array,
    damping: Array,
    is_free: NDArray[np.bool_],
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> DampedSolution | None:
    """Solve (B - sum_p s_p G_p G_p^T) x = r by Woodbury's identity (head of this module), person by person.

    The diagonal of B is multiplied by 1 + damping, and `MIN_DIAGONAL` is added.

    Args:
        diagonal: (F, n, n) symmetric diagonal blocks.
        coupling: blocks between frames, 0 between two people.
        right: (F, n) right-hand side r.
        vectors: (F, n, R) rows of the matrices G_p, one after the other: each frame has those of its own person.
        strength: (P,) factors s_p, at least 0.
        damping: (P,) relative increase of the diagonal.
        is_free: (F,) False for frames that are held.
        starts: (P,) first frame of each person.
        counts: (P,) number of frames of each person.

    Returns:
        None if the matrix of a person is not positive definite.
    """
    is_definite, solution, last_inverse = _solve_damped(
        diagonal,
        coupling.diagonal,
        coupling.corner,
        right,
        vectors,
        strength,
        damping,
        is_free,
        starts,
        counts,
    )
    return DampedSolution(solution, last_inverse) if is_definite else None


@kernel(void(FLOATS_2D, FLOATS_2D))
def _invert_lower(factor: Array, out: Array) -> None:
    """Write the inverse of the lower triangle of a matrix (n, n), with 0 above the diagonal."""
    n = len(factor)
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        out[i, i] = 1.0
        for k in range(i):
            for j in range(k + 1):
                out[i, j] -= factor[i, k] * out[k, j]
        scale = 1 / factor[i, i]
        for j in range(i + 1):
            out[i, j] *= scale


@kernel(BOOL(FLOATS_1D, FLOATS_2D))
def _is_zero(diagonal: Array, corner: Array) -> bool:
    """Return whether a block of a `Coupling` is 0."""
    for i in range(len(diagonal)):
        if diagonal[i] != 0.0:
            return False
    for i in range(len(corner)):
        for j in range(len(corner)):
            if corner[i, j] != 0.0:
                return False
    return True


@kernel(void(FLOATS_1D, FLOATS_2D, FLOATS_2D, FLOATS_2D))
def _multiply_coupling(diagonal: Array, corner: Array, inverse: Array, out: Array) -> None:
    """Add C X^T to a matrix (n, n): C a block of a `Coupling`, X the inverse of a lower triangle (n, n)."""
    n, c = len(diagonal), len(corner)
    for i in range(n):
        for j in range(i, n):
            out[i, j] += diagonal[i] * inverse[j, i]
    for a in range(c):
        for b in range(c):
            for j in range(n - c + b, n):
                out[n - c + a, j] += corner[a, b] * inverse[j, n - c + b]


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


@kernel(types.Tuple((BOOL, FLOATS_3D, FLOATS_4D, BOOLS_2D))(FLOATS_3D, FLOATS_3D, FLOATS_4D, BOOLS_1D))
def _factorise(
    lower: Array, coupling_diagonal: Array, coupling_corner: Array, is_free: NDArray[np.bool_]
) -> tuple[bool, Array, Array, NDArray[np.bool_]]:
    """Factorise B, whose diagonal blocks are overwritten.

    Returns:
        Whether B is positive definite, and `inverse`, `below` and `is_coupled` of the `BlockCholesky`.
    """
    distances, frames, n = coupling_diagonal.shape
    inverse, below = np.empty((frames, n, n)), np.zeros((distances, frames, n, n))
    is_coupled = np.zeros((distances, frames), np.bool_)
    for t in range(frames):
        if not is_free[t]:
            continue
        if not factorise_cholesky(lower[t]):
            return False, inverse, below, is_coupled
        _invert_lower(lower[t], inverse[t])
        for d in range(min(distances, frames - 1 - t)):
            if not is_free[t + d + 1]:
                is_coupled[d, t] = False
                continue
            if is_coupled[d, t]:  # what the elimination of earlier frames has left in this block
                filled = below[d, t].copy()
                below[d, t] = 0.0
                add_product_transposed(1.0, filled, inverse[t], below[d, t])
            if not _is_zero(coupling_diagonal[d, t], coupling_corner[d, t]):
                is_coupled[d, t] = True
                _multiply_coupling(coupling_diagonal[d, t], coupling_corner[d, t], inverse[t], below[d, t])
        _eliminate(t, lower, below, is_coupled)
    return True, inverse, below, is_coupled


@kernel(FLOATS_3D(FLOATS_3D, FLOATS_4D, BOOLS_2D, BOOLS_1D, FLOATS_3D))
def _solve_forward(
    inverse: Array, below: Array, is_coupled: NDArray[np.bool_], is_free: NDArray[np.bool_], right: Array
) -> Array:
    """Return L^-1 times right-hand sides (F, n, R); the other arguments are those of the `BlockCholesky`."""
    distances, frames = is_coupled.shape
    remaining, out = right.copy(), np.zeros(right.shape)
    for t in range(frames):
        if not is_free[t]:
            continue
        add_product(1.0, inverse[t], remaining[t], out[t])
        for d in range(min(distances, frames - 1 - t)):
            if is_coupled[d, t]:
                add_product(-1.0, below[d, t], out[t], remaining[t + d + 1])
    return out


@kernel(FLOATS_3D(FLOATS_3D, FLOATS_4D, BOOLS_2D, BOOLS_1D, FLOATS_3D))
def _solve_backward(
    inverse: Array, below: Array, is_coupled: NDArray[np.bool_], is_free: NDArray[np.bool_], right: Array
) -> Array:
    """Return L^-T times right-hand sides (F, n, R); the other arguments are those of the `BlockCholesky`."""
    distances, frames = is_coupled.shape
    remaining, out = right.copy(), np.zeros(right.shape)
    for t in range(frames - 1, -1, -1):
        if not is_free[t]:
            continue
        for d in range(min(distances, frames - 1 - t)):
            if is_coupled[d, t]:
                add_transposed_product(-1.0, below[d, t], out[t + d + 1], remaining[t])
        add_transposed_product(1.0, inverse[t], remaining[t], out[t])
    return out


@kernel(types.Tuple((BOOL, FLOATS_2D))(FLOATS_3D, FLOATS_4D, BOOLS_2D, BOOLS_1D, FLOATS_2D, FLOATS_3D, FLOAT))
def _solve_downdate(
    inverse: Array,
    below: Array,
    is_coupled: NDArray[np.bool_],
    is_free: NDArray[np.bool_],
    right: Array,
    vectors: Array,
    strength: float,
) -> tuple[bool, Array]:
    """Return whether the downdated matrix of one person is positive definite, and the solution (F, n)."""
    frames, n, size = len(vectors), vectors.shape[1], 1 + vectors.shape[2]
    together = np.empty((frames, n, size))
    together[:, :, 0] = right
    together[:, :, 1:] = vectors
    solved = _solve_forward(inverse, below, is_coupled, is_free, together)
    squares = np.zeros((size, size))  # of (y, V): y^T y, V^T y and V^T V
    for t in range(frames):
        if is_free[t]:
            add_transposed_product(1.0, solved[t], solved[t], squares)
    reduced, correction = np.empty((size - 1, size - 1)), np.empty((size - 1, 1))
    for i in range(size - 1):
        for j in range(size - 1):
            reduced[i, j] = -strength * squares[1 + i, 1 + j]
        reduced[i, i] += 1.0
        correction[i, 0] = strength * squares[1 + i, 0]
    if not factorise_cholesky(reduced):
        return False, right
    solve_lower(reduced, correction)
    solve_lower_transposed(reduced, correction)
    corrected = np.empty((frames, n, 1))
    for t in range(frames):
        for i in range(n):
            corrected[t, i, 0] = solved[t, i, 0]
            for j in range(size - 1):
                corrected[t, i, 0] += solved[t, i, 1 + j] * correction[j, 0]
    solution = _solve_backward(inverse, below, is_coupled, is_free, corrected)
    return True, solution.reshape((frames, n))


@kernel(
    types.Tuple((BOOL, FLOATS_2D, FLOATS_3D))(
        FLOATS_3D,
        FLOATS_3D,
        FLOATS_4D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_1D,
        FLOATS_1D,
        BOOLS_1D,
        INTS_1D,
        INTS_1D,
    )
)
def _solve_damped(
    diagonal: Array,
    coupling_diagonal: Array,
    coupling_corner: Array,
    right: Array,
    vectors: Array,
    strength: Array,
    damping: Array,
    is_free: NDArray[np.bool_],
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> tuple[bool, Array, Array]:
    """Compute `solve_damped`; one person's matrices stay in the processor's cache, those of all people may not."""
    n = diagonal.shape[1]
    solution, last_inverse = np.empty(right.shape), np.empty((len(starts), n, n))
    for p in range(len(starts)):
        own = slice(starts[p], starts[p] + counts[p])
        blocks, is_own_free = diagonal[own].copy(), is_free[own]
        for t in range(len(blocks)):
            for i in range(n):
                blocks[t, i, i] += damping[p] * blocks[t, i, i] + MIN_DIAGONAL
        is_definite, inverse, below, is_coupled = _factorise(
            blocks, coupling_diagonal[:, own].copy(), coupling_corner[:, own].copy(), is_own_free
        )
        if is_definite:
            is_definite, own_solution = _solve_downdate(
                inverse, below, is_coupled, is_own_free, right[own], vectors[own], strength[p]
            )
        if not is_definite:
            return False, solution, last_inverse
        solution[own] = own_solution
        last_inverse[p] = inverse[-1]
    return True, solution, last_inverse
