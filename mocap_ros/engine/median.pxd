# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: cdivision=True

cdef inline double find_median(double* values, Py_ssize_t n) noexcept nogil:
    """Median of a few values, which are sorted by insertion."""
    cdef Py_ssize_t i, position
    cdef double value
    for i in range(1, n):
        value, position = values[i], i
        while position > 0 and values[position - 1] > value:
            values[position] = values[position - 1]
            position -= 1
        values[position] = value
    return (values[(n - 1) // 2] + values[n // 2]) / 2
