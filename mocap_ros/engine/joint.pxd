# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

cdef void fit_lifted_pose(
    const double* joints, const double* std, double factor, const double[:, ::1] basis, const double[:, ::1] mean,
    const double[::1] sigma, int alternations, double* theta, double* scale, double* rotation,
) noexcept nogil
cdef double compute_noise_growth(
    const double[:, :, :] points, const double[:, :] score, const double[:] times, int start, int end, double unit
) noexcept nogil
