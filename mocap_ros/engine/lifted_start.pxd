# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from mocap_ros.engine.geometry cimport Vector


cdef class PoseFit:
    cdef const double[:, ::1] basis, mean
    cdef Vector std
    cdef int alternations
    cdef void fit(
        self, const double* joints, double variance, double* theta, double* scale, double* rotation
    ) noexcept nogil
