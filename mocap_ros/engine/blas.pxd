# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""SciPy's BLAS and LAPACK on matrices whose rows lie one after the other (C order).

BLAS takes matrices column by column, so it sees the transpose of each: C = A B is computed as C^T = B^T A^T, and
the lower triangle of a symmetric matrix is its upper one.
"""

from scipy.linalg.cython_blas cimport dgemm, dgemv, dtrsm
from scipy.linalg.cython_lapack cimport dpotrf


cdef inline void multiply(
    int m, int k, int n, double factor, const double* a, const double* b, double keep, double* out
) noexcept nogil:
    """C = keep C + factor A B: A (m, k), B (k, n), C (m, n)."""
    dgemm(b"N", b"N", &n, &m, &k, &factor, <double*> b, &n, <double*> a, &k, &keep, out, &n)


cdef inline void multiply_transposed(
    int m, int k, int n, double factor, const double* a, const double* b, double keep, double* out
) noexcept nogil:
    """C = keep C + factor A B^T: A (m, k), B (n, k), C (m, n)."""
    dgemm(b"T", b"N", &n, &m, &k, &factor, <double*> b, &k, <double*> a, &k, &keep, out, &n)


cdef inline void multiply_vector(
    int m, int n, double factor, const double* a, const double* x, double keep, double* out
) noexcept nogil:
    """y = keep y + factor A x: A (m, n)."""
    cdef int one = 1
    dgemv(b"T", &n, &m, &factor, <double*> a, &n, <double*> x, &one, &keep, out, &one)


cdef inline void multiply_vector_transposed(
    int m, int n, double factor, const double* a, const double* x, double keep, double* out
) noexcept nogil:
    """y = keep y + factor A^T x: A (m, n)."""
    cdef int one = 1
    dgemv(b"N", &n, &m, &factor, <double*> a, &n, <double*> x, &one, &keep, out, &one)


cdef inline void add_outer(int n, int k, double factor, const double* a, double* out) noexcept nogil:
    """C = C + factor A A^T: A (n, k), C (n, n)."""
    cdef double keep = 1
    dgemm(b"T", b"N", &n, &n, &k, &factor, <double*> a, &k, <double*> a, &k, &keep, out, &n)


cdef inline bint factorise(int n, double* a) noexcept nogil:
    """Overwrite the lower triangle of A (n, n) by L of A = L L^T; False if A is not positive definite."""
    cdef int info = 0
    dpotrf(b"U", &n, a, &n, &info)
    return info == 0


cdef inline void solve_rows(int n, int m, const double* factor, double* rows, bint transposed) noexcept nogil:
    """Overwrite each of m rows x (m, n) by L^-1 x, or by L^-T x: L the lower triangle of `factor` (n, n)."""
    cdef double one = 1
    dtrsm(b"L", b"U", b"N" if transposed else b"T", b"N", &n, &m, &one, <double*> factor, &n, rows, &n)
