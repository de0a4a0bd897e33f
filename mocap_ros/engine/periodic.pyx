# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""Steps of the periodic solver; `solvers.periodic_equations` has the formulas."""

from libc.math cimport INFINITY, NAN, ceil, cos, sin
from libc.string cimport memcpy

import numpy as np

from mocap_ros.engine.blas cimport add_outer, factorise, multiply, multiply_vector, solve_rows
from mocap_ros.engine.block_banded cimport (
    System, add_up, factorise_blocks, pad_columns, solve_backward, write_small_blocks,
)
from mocap_ros.engine.geometry cimport dot, multiply as multiply_3x3, rotation_from_vector
from mocap_ros.engine.terms cimport CAMERA
from scipy.linalg.cython_blas cimport dsyrk, dtrsv
from scipy.linalg.cython_lapack cimport dpotrf, dtrtri

cdef enum:
    COUPLED = 2  # next frames with which each camera is coupled: acceleration compares three

cdef double LARGE = 1e300  # m^2; keeps a matrix positive definite whatever is subtracted
# m^2; keeps the equations solvable where the image determines no unknown, far below the information of a seen joint
cdef double MIN_INFORMATION = 1e-12
cdef double NEWEST_S = 0.4  # s; most of a step of a walk: half of it shows that something else has begun
cdef double SAMPLE_STEP_S = 1.0 / 15  # s; at which a motion is compared, often enough for a run
cdef double MAX_STRETCH = 0.1  # of the cycle; by so much two cycles of a person differ, and a cadence is wrong
cdef int STRETCHES = 9  # lengths of a cycle that are tried
REPETITION = NEWEST_S, MAX_STRETCH  # for `solvers.classification`


cdef class StepSolver:
    """Solves for steps of windows of N frames with G unknowns of the series."""

    cdef double[:, :, ::1] rows
    cdef double[:, ::1] bordered, remaining
    cdef double[::1] x

    def __init__(self, int frames, int unknowns):
        cdef int right = pad_columns(unknowns + 1)
        self.rows = np.zeros((frames, CAMERA, (1 + COUPLED) * pad_columns(CAMERA) + right))
        self.bordered, self.remaining = np.empty((unknowns + 1, unknowns + 1)), np.zeros((frames, pad_columns(CAMERA)))
        self.x = np.zeros(right)

    def solve(
        self, double damping, const double[:, ::1] matrix, const double[::1] prior, const double[:, :, ::1] mixed,
        const double[:, :, ::1] blocks, const double[:, :, :, ::1] coupling, const double[::1] gradient,
        const double[:, ::1] camera_gradient,
    ):
        """Return dx (G,) and dz (N, 4); None where A or C, their diagonals raised by `damping`, is not definite.

        Args:
            damping: relative.
            matrix: A (G, G) without D, and D (G,).
            mixed: B^T (N, 4, G).
            blocks: C_tt (N, 4, 4).
            coupling: C_ut (N, 2, 4, 4) in the rows of frame u = t + d + 1.
            gradient: a (G,).
            camera_gradient: c (N, 4).
        """
        cdef int N = mixed.shape[0], G = mixed.shape[2], t, c, k, size = G + 1, rows = N * CAMERA
        cdef int first = (1 + COUPLED) * pad_columns(CAMERA), right = pad_columns(size), stride = first + right
        cdef int info = 0, step = 1
        cdef double one = 1, minus = -1
        cdef double[:, ::1] bordered = self.bordered
        cdef System system = System(N, CAMERA, COUPLED, CAMERA, right, stride, &self.rows[0, 0, 0])
        write_small_blocks(&system, blocks, coupling)
        for t in range(N):
            for c in range(CAMERA):
                self.rows[t, c, c] = (1 + damping) * self.rows[t, c, c] + MIN_INFORMATION
                memcpy(&self.rows[t, c, first], &mixed[t, c, 0], G * sizeof(double))
                self.rows[t, c, first + G] = camera_gradient[t, c]
        if not factorise_blocks(&system):  # (V, v) in the place of (B^T, c)
            return None
        for k in range(G):
            memcpy(&bordered[k, 0], &matrix[k, 0], G * sizeof(double))
            bordered[k, k] = (1 + damping) * (bordered[k, k] + prior[k]) + MIN_INFORMATION
            bordered[k, G] = gradient[k]
        bordered[G, G] = LARGE
        # upper triangles, whose factorisation is faster than that of lower ones
        dsyrk(b'L', b'N', &size, &rows, &minus, &self.rows[0, 0, first], &stride, &one, &bordered[0, 0], &size)
        dpotrf(b'L', &size, &bordered[0, 0], &size, &info)
        if info != 0:
            return None
        self.x[:] = 0
        self.x[G] = bordered[G, G]
        dtrsv(b'L', b'T', b'N', &size, &bordered[0, 0], &size, &self.x[0], &step)
        for t in range(N):
            for c in range(CAMERA):
                self.remaining[t, c] = -add_up(right, &self.rows[t, c, first], &self.x[0])
        solve_backward(&system, &self.remaining[0, 0])
        return np.array(self.x[:G]), np.array(self.remaining[:, :CAMERA])


def evaluate(
    const double[::1] times, double omega, const double[:, ::1] coefficients, const double[:, :, ::1] rotation,
    double[:, ::1] terms,
):
    """Write the terms (N, P) of the series; return their values (N, m), and rotations C_t Rz(psi_t) (N, 3, 3)."""
    cdef int N = terms.shape[0], P = terms.shape[1], m = coefficients.shape[1], t, h, i
    cdef double c, s
    cdef double[:, ::1] functions = np.empty((N, m))
    cdef double[:, :, ::1] turned = np.empty((N, 3, 3))
    for t in range(N):
        terms[t, 0] = 1
        for h in range(1, P // 2 + 1):
            terms[t, 2 * h - 1], terms[t, 2 * h] = cos(omega * times[t] * h), sin(omega * times[t] * h)
    multiply(N, P, m, 1, &terms[0, 0], &coefficients[0, 0], 0, &functions[0, 0])
    for t in range(N):
        c, s = cos(functions[t, m - 1]), sin(functions[t, m - 1])
        for i in range(3):
            turned[t, i, 0] = c * rotation[t, i, 0] + s * rotation[t, i, 1]
            turned[t, i, 1] = c * rotation[t, i, 1] - s * rotation[t, i, 0]
            turned[t, i, 2] = rotation[t, i, 2]
    return np.asarray(functions), np.asarray(turned)


def assemble(
    const double[:, ::1] terms, const double[:, ::1] slopes, const double[:, :, ::1] rotation,
    const double[:, :, :] diagonal, const double[:, :, ::1] cameras, const double[:, :] gradient,
    const double[:, :, ::1] bone_vectors, double[:, ::1] out, double[::1] out_gradient, double[:, :, ::1] mixed,
):
    """Write A (G, G), a (G,) and B^T (N, 4, G) of the body alone.

    Args:
        terms: (N, P) of the series.
        slopes: slope_tl (N, m).
        rotation: C_t (N, 3, 3).
        diagonal: H_t (N, n, n), of which the upper triangles are read.
        cameras: those of the cameras (N, 4, 4).
        gradient: h_t (N, n).
        bone_vectors: g_t (N, n, B).
    """
    cdef int N = terms.shape[0], P = terms.shape[1], m = slopes.shape[1], K = m - 1, B = bone_vectors.shape[2]
    cdef int last = P * m, pairs = P * (P + 1) // 2, t, p, q, k, l, c, i
    cdef double value
    cdef double[:, :, ::1] functions = np.empty((N, m, m)), products = np.empty((pairs, m, m))  # H'_uu
    cdef double[:, ::1] of_pairs = np.empty((pairs, N)), bones = np.zeros((last + 1, B))
    cdef double[:, ::1] of_camera = np.empty((CAMERA, m))  # H'_zu of a frame
    cdef double[::1] force = np.empty(m), by_omega = np.empty(m)  # h'_u and H'_uu slope of a frame
    cdef double[3] vertical
    out_gradient[:] = 0
    out[last, :] = 0
    for t in range(N):
        vertical = [rotation[t, 0, 2], rotation[t, 1, 2], rotation[t, 2, 2]]
        force[K] = functions[t, K, K] = 0
        for k in range(K):
            for l in range(k, K):
                functions[t, k, l] = functions[t, l, k] = diagonal[t, k, l]
            functions[t, k, K] = functions[t, K, k] = dot(&diagonal[t, k, K], vertical)
            force[k] = gradient[t, k]
            for c in range(CAMERA):
                of_camera[c, k] = diagonal[t, k, K + c]
        for c in range(CAMERA):
            of_camera[c, K] = dot(&cameras[t, c, 0], vertical)
        for i in range(3):
            functions[t, K, K] += vertical[i] * of_camera[i, K]
            force[K] += vertical[i] * gradient[t, K + i]
        multiply_vector(m, m, 1, &functions[t, 0, 0], &slopes[t, 0], 0, &by_omega[0])
        i = 0
        for p in range(P):
            value = terms[t, p]
            for q in range(p + 1):
                of_pairs[i, t] = value * terms[t, q]
                i += 1
            for k in range(m):
                out_gradient[p * m + k] += value * force[k]
                out[last, p * m + k] += value * by_omega[k]
                for c in range(CAMERA):
                    mixed[t, c, p * m + k] = value * of_camera[c, k]
            for k in range(K):
                for l in range(B):
                    bones[p * m + k, l] += value * bone_vectors[t, k, l]
        for c in range(CAMERA):
            mixed[t, c, last] = 0
        for k in range(m):
            value = slopes[t, k]
            out_gradient[last] += value * force[k]
            out[last, last] += value * by_omega[k]
            for c in range(CAMERA):
                mixed[t, c, last] += of_camera[c, k] * value
            for l in range(B if k < K else 0):
                bones[last, l] += value * bone_vectors[t, k, l]
    multiply(pairs, N, m * m, 1, &of_pairs[0, 0], &functions[0, 0, 0], 0, &products[0, 0, 0])
    i = 0
    for p in range(P):
        for q in range(p + 1):
            for k in range(m):
                memcpy(&out[p * m + k, q * m], &products[i, k, 0], m * sizeof(double))
                memcpy(&out[q * m + k, p * m], &products[i, k, 0], m * sizeof(double))
            i += 1
    out[:last, last] = out[last, :last]
    add_outer(last + 1, B, -1.0 / N, &bones[0, 0], &out[0, 0])


def count_effective_parameters(
    const double[:, ::1] matrix, const double[::1] prior, const double[:, :, ::1] image, const double[:, :, ::1] blocks
):
    """Return tr(A^-1 (A - D)) + sum_t tr(C_tt^-1 H'_zz,t).

    Args:
        matrix: A (G, G) without D.
        prior: the diagonal of D (G,).
        image: H'_zz (N, 4, 4).
        blocks: C_tt (N, 4, 4).

    Raises:
        LinAlgError: A or a C_tt is not positive definite.
    """
    cdef int G = matrix.shape[0], info = 0, i, j, t
    cdef double[:, ::1] factor = np.array(matrix)
    cdef double total = G
    cdef double[CAMERA * CAMERA] block
    cdef double[CAMERA * CAMERA] rows
    for i in range(G):
        factor[i, i] += prior[i] + MIN_INFORMATION
    dpotrf(b'L', &G, &factor[0, 0], &G, &info)
    if info != 0:
        raise np.linalg.LinAlgError('the matrix of the series is not positive definite')
    dtrtri(b'L', b'N', &G, &factor[0, 0], &G, &info)
    for j in range(G):
        for i in range(j, G):
            total -= factor[j, i] * factor[j, i] * prior[j]
    for t in range(image.shape[0]):
        memcpy(rows, &image[t, 0, 0], sizeof(rows))
        memcpy(block, &blocks[t, 0, 0], sizeof(block))
        for i in range(CAMERA):
            block[(CAMERA + 1) * i] += MIN_INFORMATION
        if not factorise(CAMERA, block):
            raise np.linalg.LinAlgError('the matrix of a camera is not positive definite')
        solve_rows(CAMERA, CAMERA, block, rows, False)
        solve_rows(CAMERA, CAMERA, block, rows, True)
        for i in range(CAMERA):
            total += rows[(CAMERA + 1) * i]
    return total


def turn_rotations(const double[:, :] vectors, const double[:, :, ::1] rotations):
    """Return exp([v]x) R (N, 3, 3) of rotation vectors v (N, 3) rad."""
    cdef Py_ssize_t t
    cdef double[9] turn
    cdef double[3] vector
    cdef double[:, :, ::1] out = np.empty_like(rotations)
    for t in range(out.shape[0]):
        vector = [vectors[t, 0], vectors[t, 1], vectors[t, 2]]
        rotation_from_vector(vector, turn)
        multiply_3x3(turn, &rotations[t, 0, 0], &out[t, 0, 0])
    return np.asarray(out)


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
