# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
# cython: cdivision=True

cdef extern from *:
    """
    #define TILE_ROWS 4
    #define TILE_COLUMNS 8

    /* Compiled also for processors with fused multiply-add, which is chosen when the module is loaded. */
    #if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__)
    #define WIDE __attribute__((target_clones("default", "fma"), optimize("fp-contract=fast")))
    #else
    #define WIDE
    #endif

    /* C += factor A^T B of a tile C (4, 8), with the rows first <= k < end of A and B. With a pivot U (4, 4), which
       has reciprocals on its diagonal, then U^-T C. */
    WIDE static void add_products(Py_ssize_t first, Py_ssize_t end, double factor, const double *a, const double *b,
                                  Py_ssize_t stride, double *__restrict out, Py_ssize_t width, const double *pivot) {
        double c[4][8];
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 8; j++)
                c[i][j] = 0;
        for (Py_ssize_t k = first; k < end; k++)
            for (int i = 0; i < 4; i++)
                for (int j = 0; j < 8; j++)
                    c[i][j] += a[k * stride + i] * b[k * stride + j];
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 8; j++)
                c[i][j] = out[i * width + j] + factor * c[i][j];
        if (pivot) {
            const double *p = pivot, *q = p + width, *r = q + width, *s = r + width;
            for (int j = 0; j < 8; j++) {
                c[0][j] = c[0][j] * p[0];
                c[1][j] = (c[1][j] - p[1] * c[0][j]) * q[1];
                c[2][j] = (c[2][j] - p[2] * c[0][j] - q[2] * c[1][j]) * r[2];
                c[3][j] = (c[3][j] - p[3] * c[0][j] - q[3] * c[1][j] - r[3] * c[2][j]) * s[3];
            }
        }
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 8; j++)
                out[i * width + j] = c[i][j];
    }

    /* a^T b, of a number of elements that is a multiple of 8. */
    WIDE static double add_up(Py_ssize_t size, const double *a, const double *b) {
        double sums[8] = {0, 0, 0, 0, 0, 0, 0, 0};
        for (Py_ssize_t k = 0; k < size; k += 8)
            for (int j = 0; j < 8; j++)
                sums[j] += a[k + j] * b[k + j];
        return ((sums[0] + sums[4]) + (sums[2] + sums[6])) + ((sums[1] + sums[5]) + (sums[3] + sums[7]));
    }
    """
    enum:
        TILE_ROWS
        TILE_COLUMNS
    void add_products(
        Py_ssize_t, Py_ssize_t, double, const double*, const double*, Py_ssize_t, double*, Py_ssize_t, const double*
    ) noexcept nogil
    double add_up(Py_ssize_t, const double*, const double*) noexcept nogil


cdef struct System:
    # The rows (B_tt, B_t,t+1, ..., B_t,t+D, R_t) of all frames; of B_tt only the upper triangle is read. The columns
    # of each, and the rows, are filled up with zeros to whole tiles.
    int frames, n, distances, corner, right  # F, n, D, c, columns of R
    int stride  # numbers in a row
    double* rows  # (F, pad_rows(n), stride)


cdef inline int pad_rows(int n) noexcept nogil:
    return (n + TILE_ROWS - 1) // TILE_ROWS * TILE_ROWS


cdef inline int pad_columns(int n) noexcept nogil:
    return (n + TILE_COLUMNS - 1) // TILE_COLUMNS * TILE_COLUMNS


cdef bint factorise_blocks(System* s) noexcept nogil
cdef void solve_forward(int n, int right, int stride, double* rows) noexcept nogil
cdef void solve_backward(System* s, double* out) noexcept nogil
cdef void write_small_blocks(
    System* s, const double[:, :, ::1] blocks, const double[:, :, :, ::1] coupling
) noexcept nogil
