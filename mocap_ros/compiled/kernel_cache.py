# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The cache of compiled kernels: one file for each kernel, whose name says what its machine code depends on.

Numba has a cache of its own, which knows of one source file for each function. It loads outdated code where a
called function in another file has changed, or where an earlier run was ended while it wrote; it fails at damaged
files; and it does not read a folder that it cannot write. Here, the name of a file holds

- a hash of the processor, the versions of Python, Numba and LLVM, and Numba's options that change the code,
- a hash of the signature, for one function may be compiled for several, and
- a hash of the source texts of the kernel, of all functions that it calls, and of the constants that it uses,

so what has changed is compiled anew, and a file's content never changes. The file begins with the hash of its
content, so a damaged file is noticed and replaced. Files appear under their name when they are complete, so two
processes that compile at once do not disturb each other.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

PACKAGE = 'mocap_ros'
SUFFIX = '.kernel'
NAME_BYTES = 8  # bytes of each hash in a file's name, enough for names that differ
LIBRARIES = {'builtins', 'math', 'numba', 'numpy'}  # what kernels use besides this package
DIGEST_BYTES = hashlib.sha256().digest_size


class KernelCache:
    """The cache of one kernel, with the methods that Numba's dispatcher calls.

    Args:
        function: The kernel's Python function.

    Attributes:
        write_error: Why the compiled kernel could not be written; empty where it was.
    """

    def __init__(self, function: FunctionType) -> None:
        self._function = function
        self._source_hash = ''  # until it is needed: by then the kernel's module has been imported completely
        self.write_error = ''

    @property
    def cache_path(self) -> str:
        """The folder that is preferred for writing."""
        return str(_list_folders()[0])

    def is_stored(self, signature: Any, target: Any) -> bool:
        """Return whether there is a file for the kernel, which may still turn out to be damaged."""
        for path in self._list_paths(signature, target):
            with suppress(OSError):  # a folder that may not be entered holds nothing for this user
                if path.is_file():
                    return True
        return False

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled kernel, or None where no folder has an undamaged file.

        Args:
            signature: Types of the kernel's arguments and of its result.
            target: Numba's context of the processor.
        """
        target.refresh()  # Numba's own functions must be known before code that may call them is loaded
        for path in self._list_paths(signature, target):
            with suppress(Exception):  # whatever is wrong with a file, the kernel can be compiled
                content = path.read_bytes()
                digest, payload = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
                if self._compute_digest(payload) == digest:
                    state = pickle.loads(payload)  # noqa: S301, written by this user
                    kernel = CompileResult._rebuild(target, *state)
                    _, _, (_, bitcode) = state[0]
                    _defer_parsing(kernel.library, bitcode)
                    return kernel
        return None

    def _compute_digest(self, payload: bytes) -> bytes:
        """Return the digest of what is stored for this kernel; the content of another kernel has another one."""
        name = f'{self._function.__module__}.{self._function.__qualname__}\0'
        return hashlib.sha256(name.encode() + payload).digest()

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write a compiled kernel into the first folder that can be written, and remove its outdated files there.

        Raises:
            ValueError: The machine code refers to addresses of this process, as it does for large constant arrays.
        """
        if result.library.has_dynamic_globals:
            name = self._function.__qualname__
            raise ValueError(f'{name} cannot be cached: pass arrays that are large or not contiguous as arguments')
        payload = dumps(result._reduce())
        content = self._compute_digest(payload) + payload
        errors = []
        for path in self._list_paths(signature, result.target_context):
            try:
                _write_at_once(path, content)
            except OSError as error:
                errors.append(f'{path.parent}: {error.strerror}')
                continue
            _remove_outdated(path)
            return
        self.write_error = '; '.join(errors)

    def _list_paths(self, signature: Any, target: Any) -> Iterator[Path]:
        """Yield the kernel's file in each folder of the cache."""
        self._source_hash = self._source_hash or _hash(_describe_sources(self._function))
        environment = _hash(_describe_environment(target))
        kernel = f'{self._function.__module__}.{self._function.__qualname__}'
        name = f'{kernel}-{environment}-{_hash([str(signature)])}-{self._source_hash}{SUFFIX}'
        return (folder / name for folder in _list_folders())


def _defer_parsing(library: Any, bitcode: bytes) -> None:
    """Forget the parsed form of a kernel that was loaded, until another kernel that calls it must be compiled.

    The machine code does not need it, and it takes half a megabyte for each kernel, ten times as much as its text.

    Args:
        library: the code of a kernel, as Numba has loaded it.
        bitcode: the text in LLVM's intermediate language that it was parsed from.
    """

    def parse() -> Any:
        if library._shared_module is None:
            library._shared_module = llvmlite.binding.parse_bitcode(bitcode)
        return library._shared_module

    library._shared_module, library._get_module_for_linking = None, parse


def _list_folders() -> list[Path]:
    """Return the folders of the cache in the order in which they are tried.

    They are the package's own folder and the user's cache folder, or NUMBA_CACHE_DIR alone if it is set.
    """
    package = Path(__file__).resolve().parents[1]
    own_name = f'{PACKAGE}-{_hash([str(package)])}'  # keeps the files of several installations apart
    if numba.config.CACHE_DIR:
        return [Path(numba.config.CACHE_DIR) / own_name]
    folders = [package / 'compiled' / '__pycache__']
    with suppress(RuntimeError):  # there is no home
        user = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
        folders.append(Path(user) / PACKAGE / own_name)
    return folders


def _write_at_once(path: Path, content: bytes) -> None:
    """Write a file that appears when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f'{path.name}.')
    try:
        with os.fdopen(descriptor, 'wb') as file:
            file.write(content)
        Path(temporary).chmod(0o644)  # other users may read what the owner of the package has compiled
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _remove_outdated(path: Path) -> None:
    """Remove the files of the same kernel, environment and signature whose sources have changed since.

    Files that do not name a signature are of an earlier version.
    """
    same_signature, _, _ = path.name.rpartition('-')
    same_environment, _, _ = same_signature.rpartition('-')
    for other in path.parent.glob(f'{same_environment}-*{SUFFIX}'):
        if other != path and other.name.rpartition('-')[0] in (same_signature, same_environment):
            with suppress(OSError):
                other.unlink()


def _describe_environment(target: Any) -> Iterator[str]:
    """Yield what the machine code depends on besides the sources."""
    yield from map(str, target.codegen().magic_tuple())  # the processor and its features
    yield from (str(sys.implementation.cache_tag), numba.__version__, llvmlite.__version__)
    yield from (str(numba.config.OPT), str(numba.config.BOUNDSCHECK))


def _describe_sources(kernel: FunctionType) -> Iterator[str]:
    """Yield all source texts that the machine code of a kernel is made from, and the constants in it.

    They are the source of the kernel and of all kernels that it calls. Of another function, which may be compiled
    by a rule beside it, it is the whole file.
    """
    waiting: list[Any] = [kernel]
    described: set[Any] = set()
    while waiting:
        function = waiting.pop()
        if function in described:
            continue
        described.add(function)
        is_kernel = function is kernel or hasattr(function, 'py_func')
        function = getattr(function, 'py_func', function)
        if not is_kernel:
            yield Path(inspect.getfile(function)).read_text(encoding='utf-8')
            continue
        yield inspect.getsource(function)
        for name, value in _list_referenced(function):
            if isinstance(value, bool | int | float | str | tuple | np.generic | np.ndarray):
                yield f'{name} = {value.tobytes()!r}' if isinstance(value, np.ndarray) else f'{name} = {value!r}'
            elif _may_change(value):
                waiting.append(value)


def _list_referenced(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Yield the names that a function uses from its surroundings, and their values."""
    variables = inspect.getclosurevars(function)
    for name, value in sorted({**variables.globals, **variables.nonlocals}.items()):
        if isinstance(value, ModuleType):
            # of a module, the attributes that the function uses
            yield from ((f'{name}.{a}', getattr(value, a)) for a in sorted(variables.unbound) if hasattr(value, a))
        else:
            yield name, value


def _may_change(function: Any) -> bool:
    """Return whether something is a function whose source text is not that of a library in the environment."""
    module = getattr(function, '__module__', None)
    return callable(function) and isinstance(module, str) and module.partition('.')[0] not in LIBRARIES


def _hash(texts: Any) -> str:
    digest = hashlib.sha256()
    for text in texts:
        digest.update(text.encode() + b'\0')
    return digest.hexdigest()[: 2 * NAME_BYTES]
