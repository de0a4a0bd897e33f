# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Kernels: functions over NumPy arrays that Numba compiles, each for the one signature that it declares.

A kernel is compiled before it is used and never between two frames: whoever begins to compute calls
`compile_kernels` first, which compiles what has been declared since the last call, or loads it from the cache
(`kernel_cache.py`). Where nobody did, the first call of any kernel does it. A call with other types than the
declared ones is an error and not a new compilation; only numbers are converted.

Kernels are deterministic: they use one thread, and floating-point operations keep the order that the code gives
them (no fastmath). With the environment variable NUMBA_DISABLE_JIT=1 the same functions run uncompiled.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, NoReturn, TypeVar

import numba
from numba import boolean, float64, int64, types

from mocap_ros.compiled.kernel_cache import KernelCache

Function = TypeVar('Function', bound=Callable[..., Any])

# Types of arguments. Arrays are C-contiguous; the number of dimensions is that of the name. A kernel only reads
# arrays of the types INPUT_...; they accept all arrays, the others only arrays that may be written to.
FLOAT = float64
INT = int64
BOOL = boolean
FLOATS_1D = float64[::1]
FLOATS_2D = float64[:, ::1]
FLOATS_3D = float64[:, :, ::1]
FLOATS_4D = float64[:, :, :, ::1]
INTS_1D = int64[::1]
BOOLS_1D = boolean[::1]
BOOLS_2D = boolean[:, ::1]
INPUT_1D, INPUT_2D, INPUT_3D, INPUT_4D = (types.Array(float64, n, 'C', readonly=True) for n in (1, 2, 3, 4))
INPUT_INTS_1D = types.Array(int64, 1, 'C', readonly=True)
INPUT_BOOLS_1D, INPUT_BOOLS_2D = (types.Array(boolean, n, 'C', readonly=True) for n in (1, 2))

LOGGER = logging.getLogger('mocap_ros')

_lock = threading.Lock()  # guards the list of pending kernels
_pending: list[tuple[Any, Any]] = []  # dispatchers of kernels that are not compiled yet, with their signatures


class CompilationReport(NamedTuple):
    """What `compile_kernels` did.

    Attributes:
        kernels: Number of kernels that are now ready.
        compiled: Number of those that were not in the cache and were compiled.
        seconds: Time in s that this took.
    """

    kernels: int
    compiled: int
    seconds: float

    def __str__(self) -> str:
        loaded = self.kernels - self.compiled
        return f'{self.kernels} compiled functions are ready after {self.seconds:.1f} s, {loaded} from the cache'


def is_compiling() -> bool:
    """Return whether `compile_kernels` is running."""
    return _lock.locked()


def kernel(signature: Any) -> Callable[[Function], Function]:
    """Declare a function as a kernel; kernels that it calls must have been declared before.

    A function may be declared for several signatures, each of which gives a kernel of its own.

    Args:
        signature: Numba's signature, for example `void(FLOATS_2D, INTS_1D)`.
    """

    def declare(function: Function) -> Function:
        if numba.config.DISABLE_JIT:
            return function
        dispatcher = numba.njit(error_model='numpy')(function)
        dispatcher._cache = KernelCache(dispatcher.py_func)
        dispatcher._compile_for_args = partial(_compile_at_first_call, dispatcher)
        dispatcher._explain_matching_error = partial(_refuse_call, dispatcher, signature)
        with _lock:
            _pending.append((dispatcher, signature))
        return dispatcher

    return declare


def compile_kernels(warn: Callable[[str], object] = LOGGER.warning) -> CompilationReport:
    """Compile the kernels that were declared since the last call, or load them from the cache.

    Args:
        warn: Function that is called with a line of text before something is compiled, which takes long, and if
            what was compiled could not be written to the cache.
    """
    start_s = time.monotonic()
    kernels = compiled = 0
    write_error = ''
    with _lock:
        missing = sum(not d._cache.is_stored(signature, d.targetctx) for d, signature in _pending)
        if missing:
            warn(
                f'compiling {missing} functions, once after installation or an update; '
                'this takes one to two minutes'
            )
        for dispatcher, _ in _pending:  # a kernel that was declared before one cannot call it with other types
            dispatcher._can_compile = False
        while _pending:
            dispatcher, signature = _pending[0]
            dispatcher._can_compile = True
            try:
                dispatcher.compile(signature)
            finally:
                dispatcher._can_compile = False
            kernels += 1
            compiled += sum(dispatcher.stats.cache_misses.values())
            write_error = write_error or dispatcher._cache.write_error
            del _pending[0]
    if write_error:
        warn(
            f'the compiled functions could not be kept ({write_error}), so every start compiles them: '
            'set the environment variable NUMBA_CACHE_DIR to a folder that can be written'
        )
    return CompilationReport(kernels, compiled, time.monotonic() - start_s)


def _compile_at_first_call(dispatcher: Any, *_: object) -> Any:
    """Compile all kernels; return what Numba calls then, which is the same kernel."""
    compile_kernels()
    return dispatcher


def _refuse_call(dispatcher: Any, signature: Any, *arguments: object) -> NoReturn:
    """Raise the error of a call that does not fit the kernel's signature."""
    name = f'{dispatcher.__module__}.{dispatcher.__qualname__}'
    given = ', '.join(str(dispatcher.typeof_pyval(argument)) for argument in arguments)
    expected = ', '.join(map(str, signature.args))
    raise TypeError(f'the kernel {name} was called with ({given}) instead of ({expected})')
