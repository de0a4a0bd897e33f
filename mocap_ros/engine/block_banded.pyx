# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The Cholesky factorisation of a symmetric block-banded matrix, frame by frame.

B is positive definite, with one n x n block for each of F frames and blocks between a frame and the next D frames
(D is 1 for velocities, 2 for accelerations). These are diagonal except for their last c rows and columns. With the
blocks B_ut in the rows of frame u and the columns of frame t, B = L L^T is

    L_tt L_tt^T = B_tt,    L_ut = B_ut L_tt^-T  for u = t + 1 ... t + D,    then  B_uv <- B_uv - L_ut L_vt^T

for all u >= v > t. The inverses X_t = L_tt^-1 are formed, since for blocks of this size products are two to three
times as fast as triangular solutions, and since B_ut X_t^T costs next to nothing where B_ut is almost diagonal.

Frames that are not free are held: their rows and columns are left out of the system, and solutions are 0 there.
"""

from libc.math cimport log
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.blas cimport (
    add_outer, factorise, multiply, multiply_transposed, multiply_vector, multiply_vector_transposed,
)


cdef void invert_lower(int n, const double* factor, double* out) noexcept nogil:
    """Write the inverse of the lower triangle of a matrix (n, n), with 0 above the diagonal."""
    cdef int i, j, k
    cdef double value, scale
    cdef double* row
    memset(out, 0, n * n * sizeof(double))
    for i in range(n):
        row = out + i * n
        for k in range(i):
            value = factor[i * n + k]
            for j in range(k + 1):
                row[j] -= value * out[k * n + j]
        scale = 1 / factor[i * n + i]
        for j in range(i):
            row[j] *= scale
        row[i] = scale


cdef bint is_zero(int n, const double* values) noexcept nogil:
    cdef int i
    for i in range(n):
        if values[i] != 0:
            return False
    return True


cdef bint factorise_blocks(
    Factor* f, double* blocks, const double* diagonal, const double* corners, double* scratch
) noexcept nogil:
    """Factorise B; False if it is not positive definite.

    Args:
        f: its sizes and `is_free` are read, all else is written.
        blocks: (F, n, n) lower triangles of the blocks on the diagonal, overwritten.
        diagonal: (F, D, n) diagonals of the blocks between frames t and t + d + 1.
        corners: (F, D, c, c) what is added to the last c rows and columns of these.
        scratch: (n, n).
    """
    cdef int t, d, e, i, j, a, n = f.n, c = f.corner, distances = f.distances, last, first = f.n - f.corner
    cdef const double* on_diagonal
    cdef const double* corner
    cdef const double* inverse
    cdef double* block
    cdef char* coupled
    memset(f.is_coupled, 0, f.frames * distances)
    for t in range(f.frames):
        if not f.is_free[t]:
            continue
        if not factorise(n, blocks + t * n * n):
            return False
        inverse = f.inverse + t * n * n
        invert_lower(n, blocks + t * n * n, f.inverse + t * n * n)
        last, coupled = min(distances, f.frames - 1 - t), f.is_coupled + t * distances
        for d in range(last):
            block = f.below + (t * distances + d) * n * n
            on_diagonal, corner = diagonal + (t * distances + d) * n, corners + (t * distances + d) * c * c
            if not f.is_free[t + d + 1]:
                coupled[d] = False
                continue
            if coupled[d]:  # what the elimination of earlier frames has left in this block
                memcpy(scratch, block, n * n * sizeof(double))
                multiply_transposed(n, n, n, 1, scratch, inverse, 0, block)
            if is_zero(n, on_diagonal) and is_zero(c * c, corner):
                continue
            if not coupled[d]:
                memset(block, 0, n * n * sizeof(double))
            coupled[d] = True
            for i in range(n):
                for j in range(i, n):
                    block[i * n + j] += on_diagonal[i] * inverse[j * n + i]
            for a in range(c):
                for i in range(c):
                    for j in range(first + i, n):
                        block[(first + a) * n + j] += corner[a * c + i] * inverse[j * n + first + i]
        for d in range(last):
            if not coupled[d]:
                continue
            block = f.below + (t * distances + d) * n * n
            add_outer(n, n, -1, block, blocks + (t + d + 1) * n * n)
            for e in range(d):
                if coupled[e]:
                    i = (t + e + 1) * distances + d - e - 1
                    multiply_transposed(
                        n, n, n, -1, block, f.below + (t * distances + e) * n * n,
                        1 if f.is_coupled[i] else 0, f.below + i * n * n,
                    )
                    f.is_coupled[i] = True
    return True


cdef void solve_forward(Factor* f, int right, double* remaining, double* out) noexcept nogil:
    """Write L^-1 times right-hand sides (F, n, R), which are overwritten."""
    cdef int t, d, n = f.n, size = f.n * right
    for t in range(f.frames):
        if not f.is_free[t]:
            memset(out + t * size, 0, size * sizeof(double))
            continue
        multiply(n, n, right, 1, f.inverse + t * n * n, remaining + t * size, 0, out + t * size)
        for d in range(min(f.distances, f.frames - 1 - t)):
            if f.is_coupled[t * f.distances + d]:
                multiply(
                    n, n, right, -1, f.below + (t * f.distances + d) * n * n, out + t * size,
                    1, remaining + (t + d + 1) * size,
                )


cdef void solve_backward(Factor* f, double* remaining, double* out) noexcept nogil:
    """Write L^-T times one right-hand side (F, n), which is overwritten."""
    cdef int t, d, n = f.n
    for t in range(f.frames - 1, -1, -1):
        if not f.is_free[t]:
            memset(out + t * n, 0, n * sizeof(double))
            continue
        for d in range(min(f.distances, f.frames - 1 - t)):
            if f.is_coupled[t * f.distances + d]:
                multiply_vector_transposed(
                    n, n, -1, f.below + (t * f.distances + d) * n * n, out + (t + d + 1) * n, 1, remaining + t * n
                )
        multiply_vector_transposed(n, n, 1, f.inverse + t * n * n, remaining + t * n, 0, out + t * n)


def log_determinant(blocks, const double[:, :, ::1] diagonal, const double[:, :, :, ::1] corners):
    """Return log det B.

    Args:
        blocks: (F, n, n) blocks on the diagonal; their lower triangles are read.
        diagonal: (F, D, n) diagonals of the blocks in the rows of frame t + d + 1 and the columns of frame t.
        corners: (F, D, c, c) what is added to the last c rows and columns of these blocks.

    Raises:
        LinAlgError: B is not positive definite.
    """
    cdef double[:, :, ::1] work = np.array(blocks, np.float64, order='C')
    cdef Py_ssize_t frames = work.shape[0], n = work.shape[1], distances = diagonal.shape[1], t, i
    cdef double[:, :, ::1] inverse = np.empty((frames, n, n))
    cdef double[:, :, :, ::1] below = np.empty((frames, distances, n, n))
    cdef char[:, ::1] is_coupled = np.empty((frames, distances), np.int8)
    cdef double[:, ::1] scratch = np.empty((n, n))
    cdef const unsigned char[::1] is_free = np.ones(frames, np.uint8)
    cdef double total = 0
    cdef Factor factor = Factor(
        frames, n, distances, corners.shape[2], &inverse[0, 0, 0], &below[0, 0, 0, 0], &is_coupled[0, 0],
        &is_free[0],
    )
    if not factorise_blocks(&factor, &work[0, 0, 0], &diagonal[0, 0, 0], &corners[0, 0, 0, 0], &scratch[0, 0]):
        raise np.linalg.LinAlgError('the matrix is not positive definite')
    for t in range(frames):
        for i in range(n):
            total -= 2 * log(inverse[t, i, i])
    return total
