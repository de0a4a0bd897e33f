# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The Cholesky factorisation of a symmetric block-banded matrix, frame by frame.

B is positive definite, with one n x n block for each of F frames and blocks between a frame and the next D frames
(D is 1 for velocities, 2 for accelerations). These are diagonal except for their last c rows and columns. With the
blocks B_tu in the rows of frame t and the columns of frame u, and right sides R, B = U^T U and Y = U^-T R are

    U_tt^T U_tt = B_tt,    (U_tu, Y_t) = U_tt^-T (B_tu, R_t)  for u = t + 1 ... t + D
    then  B_uv <- B_uv - U_tu^T U_tv,    R_u <- R_u - U_tu^T Y_t  for all v >= u > t

Matrices of this size are in the cache, so what counts is how seldom numbers are fetched: U and Y take the place of B
and R in tiles of 4 rows and 8 columns, each of which is finished at once. On the diagonal are the reciprocals of
that of U. Where B_tu is almost diagonal, U_tu has only zeros above its diagonal, but for the last c rows. These are
left out in the blocks of the furthest frames, u = t + D, in which the elimination of earlier frames leaves nothing.
"""

from libc.math cimport log, sqrt

import numpy as np


cdef bint factorise_pivot(int rows, int stride, int column, double* tile) noexcept nogil:
    """Factorise a tile (4, 8) with its diagonal in some column; rows that only fill it up become 0."""
    cdef int k, i, j
    cdef double value
    cdef double* row
    for k in range(TILE_ROWS):
        row, value = tile + k * stride, 0
        if k < rows:
            if not row[column + k] > 0:
                return False
            value = 1 / sqrt(row[column + k])
        for j in range(column + k + 1, TILE_COLUMNS):
            row[j] *= value
        row[column + k] = value
        for i in range(k + 1, TILE_ROWS):
            for j in range(column + i, TILE_COLUMNS):
                tile[i * stride + j] -= row[column + i] * row[j]
    return True


cdef inline int find_first_row(System* s, int distance, int column) noexcept nogil:
    """Return the first row of U_tu, u = t + distance, that is not 0 from a column on."""
    return min(column, s.n - s.corner) if distance == s.distances else 0


cdef bint factorise_blocks(System* s) noexcept nogil:
    """Put U and Y in the place of B and R; False if B is not positive definite."""
    cdef int t, i, j, k, x, d, n = s.n, D = s.distances, size = pad_columns(n), start, end, first, target, source
    cdef double* rows
    cdef double* out
    cdef double* pivot
    cdef const double* earlier
    for t in range(s.frames):
        rows = s.rows + t * pad_rows(n) * s.stride
        for i from 0 <= i < n by TILE_ROWS:
            pivot = rows + i * s.stride + i
            for x in range(D + 2):  # B_t,t+x, then the right sides
                if s.frames - t <= x <= D:
                    continue
                start, end = i // TILE_COLUMNS * TILE_COLUMNS if x == 0 else 0, s.right if x > D else size
                for j from start <= j < end by TILE_COLUMNS:
                    first, target = find_first_row(s, x, j), x * size + j
                    if first >= i + TILE_ROWS:
                        break
                    out = rows + i * s.stride + target
                    for d in range(1, min(D, t) + 1):
                        if D < x + d and x <= D:
                            break
                        earlier = rows - d * pad_rows(n) * s.stride
                        source = target if x > D else target + d * size
                        k = max(find_first_row(s, d, i), find_first_row(s, x + d, j) if x <= D else 0)
                        add_products(
                            k, n, -1, earlier + d * size + i, earlier + source, s.stride, out, s.stride, NULL
                        )
                    if x == 0 and j <= i:
                        add_products(0, i, -1, rows + i, rows + target, s.stride, out, s.stride, NULL)
                        if not factorise_pivot(n - i, s.stride, i - j, out):
                            return False
                    else:
                        add_products(first, i, -1, rows + i, rows + target, s.stride, out, s.stride, pivot)
    return True


cdef void solve_forward(int n, int right, int stride, double* rows) noexcept nogil:
    """Write U^-T R of one frame in the place of R, the U of which is known: rows (U, R)."""
    cdef int i, j, size = pad_columns(n)
    for i from 0 <= i < n by TILE_ROWS:
        for j from size <= j < size + right by TILE_COLUMNS:
            add_products(0, i, -1, rows + i, rows + j, stride, rows + i * stride + j, stride, rows + i * stride + i)


cdef void solve_backward(System* s, double* out) noexcept nogil:
    """Write U^-1 y in the place of y, (F, pad_columns(n)), filled up with zeros."""
    cdef int t, i, j, n = s.n, size = pad_columns(n)
    cdef double value
    cdef double* x
    cdef const double* row
    for t in range(s.frames - 1, -1, -1):
        x = out + t * size
        for i in range(n - 1, -1, -1):
            row, value = s.rows + (t * pad_rows(n) + i) * s.stride, x[i]
            for j in range(i + 1, i // TILE_COLUMNS * TILE_COLUMNS + TILE_COLUMNS):
                value -= row[j] * x[j]
            j = i // TILE_COLUMNS * TILE_COLUMNS + TILE_COLUMNS
            value -= add_up(min(s.distances + 1, s.frames - t) * size - j, row + j, x + j)
            x[i] = value * row[i]


cdef void write_small_blocks(
    System* s, const double[:, :, ::1] blocks, const double[:, :, :, ::1] coupling
) noexcept nogil:
    """Write symmetric blocks (F, n, n) and all of those (F, D, n, n) in the rows of frame t + d + 1."""
    cdef int t, d, i, j, size = pad_columns(s.n)
    cdef double* row
    for t in range(s.frames):
        for i in range(s.n):
            row = s.rows + (t * pad_rows(s.n) + i) * s.stride
            for j in range(s.n):
                row[j] = blocks[t, i, j]
                for d in range(s.distances):
                    row[(d + 1) * size + j] = coupling[t, d, j, i]


def log_determinant(const double[:, :, ::1] blocks, const double[:, :, :, ::1] coupling):
    """Return log det B.

    Args:
        blocks: (F, n, n) symmetric blocks on the diagonal.
        coupling: (F, D, n, n) blocks in the rows of frame t + d + 1 and the columns of frame t.

    Raises:
        LinAlgError: B is not positive definite.
    """
    cdef int frames = blocks.shape[0], n = blocks.shape[1], D = coupling.shape[1], t, i
    cdef double[:, :, ::1] rows = np.zeros((frames, pad_rows(n), (D + 1) * pad_columns(n)))
    cdef System system = System(frames, n, D, n, 0, rows.shape[2], &rows[0, 0, 0])
    cdef double total = 0
    write_small_blocks(&system, blocks, coupling)
    if not factorise_blocks(&system):
        raise np.linalg.LinAlgError('the matrix is not positive definite')
    for t in range(frames):
        for i in range(n):
            total -= 2 * log(rows[t, i, i])
    return total
