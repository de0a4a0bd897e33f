# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Configure BLAS threads and memory of this process; import this module before NumPy.

The module imports only the standard library, because BLAS libraries read their settings when NumPy is imported.
"""

from __future__ import annotations

import ctypes
import gc
import os

# Environment variables that limit the threads of the BLAS libraries that NumPy and SciPy may be linked with.
BLAS_THREAD_VARIABLES = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
M_TRIM_THRESHOLD = -1  # parameter number of mallopt(3), from malloc.h
M_MMAP_THRESHOLD = -3  # likewise
TRIM_THRESHOLD_BYTES = 256 << 20  # free memory that the process keeps; far above what one solver step frees
MMAP_THRESHOLD_BYTES = 32 << 20  # the largest value that glibc accepts on 64-bit systems


def configure_process() -> None:
    """Limit BLAS to one thread and make malloc keep freed memory; call this before NumPy is imported.

    The matrices of the solvers are small, so additional BLAS threads only wait for each other. Every solver step
    allocates and frees arrays of some MB. By default the C library returns their pages to the system each time,
    and fetching them again takes a quarter of the time of a step.

    Environment variables that the user has set are kept. Without the GNU C library, malloc stays as it is.
    """
    for name in BLAS_THREAD_VARIABLES:
        os.environ.setdefault(name, '1')
    _call_glibc('mallopt', M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES)
    _call_glibc('mallopt', M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES)


def release_free_memory() -> None:
    """Collect garbage and return free pages to the system, which takes one to two milliseconds.

    Python leaves out full collections while few objects are new, which in the node they are for hours. With
    `gc.freeze`, which exempts the objects of imported libraries, one takes less than a millisecond. malloc keeps
    what is freed (`configure_process`) and would grow by MB every hour. No pages are returned without glibc.
    """
    gc.collect()
    _call_glibc('malloc_trim', 0)


def _call_glibc(name: str, *arguments: int) -> None:
    try:
        function = getattr(ctypes.CDLL(None), name)
    except (OSError, TypeError, AttributeError):
        return
    function(*arguments)
