# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The normal equations of the periodic model, in the symbols of `solvers.periodic.normal_equations`.

Sizes: N frames, n = K + 4 unknowns of the joint solver a frame, m = K + 1 functions, P terms of a series, B bones,
G = P m + 1 unknowns of the series.
"""

from libc.math cimport INFINITY, NAN, ceil
from libc.string cimport memcpy

import numpy as np

from mocap_ros.engine.blas cimport add_outer, multiply, multiply_vector
from mocap_ros.engine.block_banded cimport Factor, factorise_blocks, solve_backward, solve_forward
from scipy.linalg.cython_blas cimport dsyrk, dtrsv
from scipy.linalg.cython_lapack cimport dpotrf, dtrtri

cdef enum:
    CAMERA = 4  # unknowns of a camera

cdef double NEWEST_S = 0.4  # s; most of a step of a walk: half of it shows that something else has begun
cdef double SAMPLE_STEP_S = 1.0 / 15  # s; at which a motion is compared, often enough for a run
cdef double MAX_STRETCH = 0.1  # of the cycle; by so much two cycles of a person differ, and a cadence is wrong
cdef int STRETCHES = 9  # lengths of a cycle that are tried
REPETITION = NEWEST_S, MAX_STRETCH  # for `solvers.periodic.repetition`
cdef double LARGE = 1e300  # m^2; keeps a matrix positive definite whatever is subtracted


def assemble(
    const double[:, :, ::1] diagonal, const double[:, ::1] gradient, const double[:, :, ::1] bone_vectors,
    const double[:, :] vertical, const double[:, ::1] terms, const double[:, ::1] slopes,
):
    """Return the equations of the body alone.

    Args:
        diagonal: (N, n, n) lower triangles of H_t.
        gradient: (N, n) h_t.
        bone_vectors: (N, n, B) gradients of the bone lengths, 0 by the camera.
        vertical: (N, 3) a_t.
        terms: (N, P).
        slopes: (N, m).

    Returns:
        A (G, G), a (G,), B^T (N, 4, G), H'_zz (N, 4, 4) and h'_z (N, 4).
    """
    cdef int N = terms.shape[0], P = terms.shape[1], m = slopes.shape[1], B = bone_vectors.shape[2], K = m - 1
    cdef int G = P * m + 1, last = P * m, pairs = P * (P + 1) // 2, t, p, q, k, l, c, i
    cdef double value, slope
    arrays = (
        np.empty((G, G)), np.zeros(G), np.empty((N, CAMERA, G)), np.empty((N, CAMERA, CAMERA)), np.empty((N, CAMERA))
    )
    cdef double[:, ::1] out = arrays[0], out_camera = arrays[4]
    cdef double[::1] out_gradient = arrays[1]
    cdef double[:, :, ::1] mixed = arrays[2], image = arrays[3]
    cdef double[:, :, ::1] functions = np.empty((N, m, m)), blocks = np.empty((pairs, m, m))  # H'_uu
    cdef double[:, ::1] products = np.empty((pairs, N)), bones = np.zeros((G, B))
    cdef double[:, ::1] of_camera = np.empty((CAMERA, m))  # H'_zu of a frame
    cdef double[::1] force = np.empty(m), by_omega = np.empty(m)  # h'_u and H'_uu slope of a frame
    with nogil:
        out[last, :] = 0
        for t in range(N):
            for k in range(K):
                for l in range(k + 1):
                    functions[t, k, l] = functions[t, l, k] = diagonal[t, k, l]
                force[k] = gradient[t, k]
                value = 0
                for i in range(3):
                    value += diagonal[t, K + i, k] * vertical[t, i]
                functions[t, k, K] = functions[t, K, k] = value
            functions[t, K, K] = force[K] = 0
            for c in range(CAMERA):
                for k in range(K):
                    of_camera[c, k] = diagonal[t, K + c, k]
                of_camera[c, K] = 0
                for i in range(CAMERA):
                    image[t, c, i] = diagonal[t, K + max(c, i), K + min(c, i)]
                for i in range(3):
                    of_camera[c, K] += image[t, c, i] * vertical[t, i]
                out_camera[t, c] = gradient[t, K + c]
            for i in range(3):
                functions[t, K, K] += vertical[t, i] * of_camera[i, K]
                force[K] += vertical[t, i] * gradient[t, K + i]
            multiply_vector(m, m, 1, &functions[t, 0, 0], &slopes[t, 0], 0, &by_omega[0])
            i = 0
            for p in range(P):
                value = terms[t, p]
                for q in range(p + 1):
                    products[i, t] = value * terms[t, q]
                    i += 1
                for k in range(m):
                    out_gradient[p * m + k] += value * force[k]
                    out[last, p * m + k] += value * by_omega[k]
                for k in range(K):
                    for l in range(B):
                        bones[p * m + k, l] += value * bone_vectors[t, k, l]
                for c in range(CAMERA):
                    for k in range(m):
                        mixed[t, c, p * m + k] = value * of_camera[c, k]
            for k in range(m):
                slope = slopes[t, k]
                out_gradient[last] += slope * force[k]
                out[last, last] += slope * by_omega[k]
            for k in range(K):
                for l in range(B):
                    bones[last, l] += slopes[t, k] * bone_vectors[t, k, l]
            for c in range(CAMERA):
                mixed[t, c, last] = 0
                for k in range(m):
                    mixed[t, c, last] += of_camera[c, k] * slopes[t, k]
        multiply(pairs, N, m * m, 1, &products[0, 0], &functions[0, 0, 0], 0, &blocks[0, 0, 0])
        i = 0
        for p in range(P):
            for q in range(p + 1):
                for k in range(m):
                    memcpy(&out[p * m + k, q * m], &blocks[i, k, 0], m * sizeof(double))
                    memcpy(&out[q * m + k, p * m], &blocks[i, k, 0], m * sizeof(double))
                i += 1
        for k in range(last):
            out[k, last] = out[last, k]
        add_outer(G, B, -1.0 / N, &bones[0, 0], &out[0, 0])
    return arrays


def solve_step(
    const double[:, ::1] matrix, const double[::1] added, const double[::1] gradient, const double[:, :, ::1] mixed,
    double[:, :, ::1] blocks, const double[:, :, :, ::1] coupling, const double[:, ::1] camera_gradient,
):
    """Return dx (G,) and dz (N, 4), or None if a matrix is not positive definite.

    With S = A - V^T V and s = a - V^T v, one factorisation of a matrix that has a row and a column more, with any
    large r, also gives y = U^-T s:

        [ S    s ]   [ U^T    ] [ U  y ]        [ U  y ] [ dx ]   [ 0 ]
        [ s^T  . ] = [ y^T  r ] [    r ],       [    r ] [ 1  ] = [ r ]

    Large matrices are upper triangles, whose factorisation is faster than that of lower ones.

    Args:
        matrix: (G, G) A.
        added: (G,) what is added to its diagonal.
        gradient: (G,) a.
        mixed: (N, 4, G) B^T.
        blocks: (N, 4, 4) blocks of C on the diagonal, overwritten.
        coupling: (N, D, 4, 4) those in the rows of frame t + d + 1 and the columns of frame t.
        camera_gradient: (N, 4) c.
    """
    cdef int N = mixed.shape[0], G = mixed.shape[2], D = coupling.shape[1], t, c, k, size = G + 1
    cdef int rows = N * CAMERA, info = 0, step = 1
    cdef double one = 1, minus = -1
    cdef double[:, :, ::1] inverse = np.empty((N, CAMERA, CAMERA)), right = np.empty((N, CAMERA, size))
    cdef double[:, :, ::1] solved = np.empty((N, CAMERA, size))  # (V, v)
    cdef double[:, :, :, ::1] below = np.empty((N, D, CAMERA, CAMERA))
    cdef double[:, :, ::1] none = np.zeros((N, D, CAMERA))
    cdef char[:, ::1] is_coupled = np.empty((N, D), np.int8)
    cdef const unsigned char[::1] is_free = np.ones(N, np.uint8)
    cdef double[:, ::1] bordered = np.empty((size, size)), remaining = np.empty((N, CAMERA))
    cdef double[CAMERA * CAMERA] scratch
    cdef Factor factor = Factor(
        N, CAMERA, D, CAMERA, &inverse[0, 0, 0], &below[0, 0, 0, 0], &is_coupled[0, 0], &is_free[0]
    )
    series, cameras = np.zeros(size), np.empty((N, CAMERA))
    cdef double[::1] x = series
    cdef double[:, ::1] z = cameras
    if not factorise_blocks(&factor, &blocks[0, 0, 0], &none[0, 0, 0], &coupling[0, 0, 0, 0], scratch):
        return None
    for t in range(N):
        for c in range(CAMERA):
            memcpy(&right[t, c, 0], &mixed[t, c, 0], G * sizeof(double))
            right[t, c, G] = camera_gradient[t, c]
    solve_forward(&factor, size, &right[0, 0, 0], &solved[0, 0, 0])
    for k in range(G):
        memcpy(&bordered[k, 0], &matrix[k, 0], G * sizeof(double))
        bordered[k, k] += added[k]
        bordered[k, G] = gradient[k]
    bordered[G, G] = LARGE
    dsyrk(b'L', b'N', &size, &rows, &minus, &solved[0, 0, 0], &size, &one, &bordered[0, 0], &size)
    dpotrf(b'L', &size, &bordered[0, 0], &size, &info)
    if info != 0:
        return None
    x[G] = bordered[G, G]
    dtrsv(b'L', b'T', b'N', &size, &bordered[0, 0], &size, &x[0], &step)
    multiply_vector(rows, size, -1, &solved[0, 0, 0], &x[0], 0, &remaining[0, 0])
    solve_backward(&factor, &remaining[0, 0], &z[0, 0])
    return series[:G], cameras


def compute_trace_of_solved(const double[:, ::1] matrix, const double[::1] added, const double[::1] diagonal):
    """Return tr((A + E)^-1 D) of a symmetric matrix A (n, n) and diagonal ones E and D (n,).

    Raises:
        LinAlgError: A + E is not positive definite.
    """
    cdef int n = matrix.shape[0], info = 0, i, j
    cdef double total = 0
    cdef double[:, ::1] factor = np.array(matrix)
    for i in range(n):
        factor[i, i] += added[i]
    dpotrf(b'L', &n, &factor[0, 0], &n, &info)
    if info != 0:
        raise np.linalg.LinAlgError('the matrix is not positive definite')
    dtrtri(b'L', b'N', &n, &factor[0, 0], &n, &info)
    for j in range(n):
        for i in range(j, n):
            total += factor[j, i] * factor[j, i] * diagonal[j]
    return total


def measure_repetition(const double[::1] times, const double[:, ::1] theta, double cadence):
    """Return how well the newest part of a motion repeats what was one cycle before; NaN if that is not known.

    With theta(t) the base-pose weights at a time, n the newest 0.4 s, and c these and the cycle before them,

        r = 1 - min_T mean_n |theta(t) - theta(t - T)|^2 / (2 mean_c |theta(t) - mean_c theta|^2)

    where T is any length near that of the cycle. This is a coefficient of correlation: 1 if the motion repeats
    itself, 0 if the newest poses have nothing to do with those before, as after a walk has ended in a jump. It is
    not known where the motion is shorter, or does not move.

    Args:
        times: (F,) s, increasing.
        theta: (F, K) m, base-pose weights at these times.
        cadence: Hz, full cycles.
    """
    cdef int K = theta.shape[1], count, newest, i, k, s
    cdef double end = times[times.shape[0] - 1], known = end - times[0] - NEWEST_S, cycle = 1 / cadence
    cdef double shortest = (1 - MAX_STRETCH) * cycle, longest = min((1 + MAX_STRETCH) * cycle, known)
    cdef double spread = 0, least = INFINITY, change, mean, difference
    if known * cadence < 1:
        return NAN
    count, newest = <int> ceil((NEWEST_S + cycle) / SAMPLE_STEP_S), <int> (NEWEST_S / SAMPLE_STEP_S) + 1
    cdef double[:, ::1] poses = np.empty((count, K))
    cdef double[::1] before = np.empty(K)
    for i in range(count):
        interpolate(times, theta, end - i * SAMPLE_STEP_S, &poses[i, 0])
    for k in range(K):
        mean = 0
        for i in range(count):
            mean += poses[i, k]
        mean /= count
        for i in range(count):
            spread += (poses[i, k] - mean) * (poses[i, k] - mean)
    for s in range(STRETCHES):
        cycle, change = shortest + (longest - shortest) * s / (STRETCHES - 1), 0
        for i in range(newest):
            interpolate(times, theta, end - i * SAMPLE_STEP_S - cycle, &before[0])
            for k in range(K):
                difference = poses[i, k] - before[k]
                change += difference * difference
        least = min(least, change)
    return 1 - least / newest / (2 * spread / count) if spread > 0 else NAN


cdef void interpolate(
    const double[::1] times, const double[:, ::1] samples, double time, double* out
) noexcept nogil:
    """Write samples (n, K) of increasing times, interpolated at a time; the ends hold beyond them."""
    cdef int last = times.shape[0] - 1, after = last, k
    cdef double share
    while after > 1 and times[after - 1] >= time:
        after -= 1
    share = min(max((time - times[after - 1]) / (times[after] - times[after - 1]), 0.0), 1.0)
    for k in range(samples.shape[1]):
        out[k] = (1 - share) * samples[after - 1, k] + share * samples[after, k]
