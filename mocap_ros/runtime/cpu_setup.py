"""How a process of this package computes: with one BLAS thread, and keeping its memory from step to step."""

from __future__ import annotations

import ctypes
import os

BLAS_THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
KEPT, LARGEST_KEPT = 256 << 20, 32 << 20


def prepare() -> None:
    """To be called before NumPy is imported.

    Matrices are small: more threads only wait for each other. Arrays of some MB come and go at every step of the
    solver: fetching their pages from the system each time, as the C library does by default, takes a quarter of
    its time.
    """
    for name in BLAS_THREADS:
        os.environ.setdefault(name, '1')
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, TypeError, AttributeError):  # no GNU C library
        return
    mallopt(M_TRIM_THRESHOLD, KEPT)
    mallopt(M_MMAP_THRESHOLD, LARGEST_KEPT)
