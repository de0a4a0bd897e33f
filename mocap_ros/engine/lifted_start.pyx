# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: auto_pickle=False

"""The inner loops of `solvers.joint.lifted_start`, which has the formulas."""

from libc.math cimport sqrt
from libc.string cimport memcpy, memset

import numpy as np

from mocap_ros.engine.batch cimport JOINTS
from mocap_ros.engine.blas cimport multiply_vector, multiply_vector_transposed
from mocap_ros.engine.geometry cimport Stack, Vector

cdef double MIN_SCALE = 1e-9  # px/m; guards against a scale of zero where a lifted pose is degenerate
cdef int SQUARES = 14  # K^(2^14): what belongs to an eigenvalue that is smaller by 1 % is gone to the last digit


cdef void write_best_rotation(const double* m, double* out) noexcept nogil:
    """Write the rotation R (3, 3) that maximises tr(R^T M), M = sum_j q_j p_j^T (3, 3): the closest R p_j to q_j.

    tr(R^T M) is a quadratic form of the quaternion of R, with a matrix K (4, 4) (Horn 1987). Its eigenvalues are
    within 3^(1/2) |M|, so each column of high powers of K + 3^(1/2) |M| I is along the eigenvector of the largest.
    Where others are nearly as large, as with an M of rank 1, it is a combination of theirs, and its rotation nearly
    as good as the best. Where M is 0 the rotation is I.
    """
    cdef int i, j, a, square, largest = 0
    cdef double size = 0, trace, w, x, y, z
    cdef double[4][4] k
    cdef double[4][4] power
    for i in range(9):
        size += m[i] * m[i]
        out[i] = i % 4 == 0
    if not size > 0:
        return
    k[0][:] = [m[0] + m[4] + m[8], m[7] - m[5], m[2] - m[6], m[3] - m[1]]
    k[1][:] = [k[0][1], m[0] - m[4] - m[8], m[3] + m[1], m[2] + m[6]]
    k[2][:] = [k[0][2], k[1][2], m[4] - m[0] - m[8], m[7] + m[5]]
    k[3][:] = [k[0][3], k[1][3], k[2][3], m[8] - m[0] - m[4]]
    for i in range(4):
        k[i][i] += sqrt(3 * size)
    for square in range(SQUARES):
        trace = k[0][0] + k[1][1] + k[2][2] + k[3][3]
        for i in range(4):
            for j in range(4):
                power[i][j] = 0
                for a in range(4):
                    power[i][j] += k[i][a] * k[a][j] / (trace * trace)
        memcpy(k, power, sizeof(k))
    for i in range(1, 4):
        largest = i if k[i][i] > k[largest][largest] else largest
    w, x, y, z = k[largest][0], k[largest][1], k[largest][2], k[largest][3]
    size = 2 / (w * w + x * x + y * y + z * z)
    out[0], out[1], out[2] = 1 - size * (y * y + z * z), size * (x * y - w * z), size * (x * z + w * y)
    out[3], out[4], out[5] = size * (x * y + w * z), 1 - size * (x * x + z * z), size * (y * z - w * x)
    out[6], out[7], out[8] = size * (x * z - w * y), size * (y * z + w * x), 1 - size * (x * x + y * y)


cdef class PoseFit:
    """Fits weights and cameras to lifted poses.

    Args:
        model: base poses.
        arrays: `models.base_poses.ModelArrays` of them.
        alternations: rounds of cameras and weights.
    """

    def __init__(self, model, arrays, int alternations):
        self.basis, self.mean, self.std, self.alternations = arrays.components, model.mean, model.std, alternations

    cdef void fit(
        self, const double* joints, double variance, double* theta, double* scale, double* rotation
    ) noexcept nogil:
        """Fit weights (K,) and a camera to a lifted pose (J, 3) whose coordinates have this variance."""
        cdef int K = self.basis.shape[1], i, j, turn
        cdef double squares, along, std
        cdef double[9] products
        cdef double[3 * JOINTS] pose
        memset(theta, 0, K * sizeof(double))
        for turn in range(self.alternations):
            memcpy(pose, &self.mean[0, 0], sizeof(pose))
            multiply_vector(3 * JOINTS, K, 1, &self.basis[0, 0], theta, 1, pose)
            memset(products, 0, sizeof(products))
            squares, along = 0, 0
            for i in range(3 * JOINTS):
                squares += pose[i] * pose[i]
                for j in range(3):
                    products[3 * (i % 3) + j] += joints[i] * pose[i // 3 * 3 + j]
            write_best_rotation(products, rotation)
            for i in range(9):
                along += rotation[i] * products[i]
            scale[0] = max(along / squares, MIN_SCALE)
            for j in range(JOINTS):
                for i in range(3):
                    pose[3 * j + i] = (
                        rotation[i] * joints[3 * j] + rotation[3 + i] * joints[3 * j + 1]
                        + rotation[6 + i] * joints[3 * j + 2]
                    ) / scale[0] - self.mean[j, i]
            multiply_vector_transposed(3 * JOINTS, K, 1, &self.basis[0, 0], pose, 0, theta)
            for i in range(K):
                std = scale[0] * self.std[i]
                theta[i] /= 1 + variance / (std * std)

    def fit_all(self, Stack joints, Vector variances):
        """Return weights (F, K), scales (F,) and rotations (F, 3, 3) of lifted poses (F, J, 3)."""
        cdef Py_ssize_t t, frames = joints.shape[0]
        theta, scale, rotation = np.zeros((frames, len(self.std))), np.empty(frames), np.empty((frames, 3, 3))
        cdef double[:, ::1] weights = theta
        cdef double[::1] scales = scale
        cdef double[:, :, ::1] rotations = rotation
        for t in range(frames):
            self.fit(&joints[t, 0, 0], variances[t], &weights[t, 0], &scales[t], &rotations[t, 0, 0])
        return theta, scale, rotation
