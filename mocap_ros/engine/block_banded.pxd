# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

cdef struct Factor:
    int frames, n, distances, corner
    double* inverse  # (F, n, n) X_t = L_tt^-1, 0 above the diagonal
    double* below  # (F, D, n, n) L_ut for u = t + 1 ... t + D
    char* is_coupled  # (F, D) whether these are not 0
    const unsigned char* is_free  # (F,)

cdef bint factorise_blocks(
    Factor* f, double* blocks, const double* diagonal, const double* corners, double* scratch
) noexcept nogil
cdef void solve_forward(Factor* f, int right, double* remaining, double* out) noexcept nogil
cdef void solve_backward(Factor* f, double* remaining, double* out) noexcept nogil
