# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is loaded from the cache, what is compiled anew, and what happens where the cache cannot be used."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import llvmlite
import numba
import pytest

from mocap_ros.compiled import kernel as kernels
from mocap_ros.compiled.kernel import CompilationReport, compile_kernels
from tests.support.full_disk import limit_file_size
from tests.support.paths import ROOT

CALLER = """
from callee import add, plain_limit
from mocap_ros.compiled.kernel import FLOAT, kernel

STEP = 1.0

@kernel(FLOAT(FLOAT))
def advance(value):
    return add(value, STEP) + LIMITS[0]

@kernel(FLOAT(FLOAT))
def negate(value):
    return -value

LIMITS = (0.0, 1.0)
"""
CALLEE = """
from mocap_ros.compiled.kernel import FLOAT, kernel

def plain_limit():
    return 5.0

@kernel(FLOAT(FLOAT, FLOAT))
def add(a, b):
    return a + b
"""


class Sources:
    """Two modules with kernels, and a cache of their own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._monkeypatch = monkeypatch
        self._sources, self.cache = folder / 'sources', folder / 'cache'
        self._sources.mkdir()
        monkeypatch.setattr(numba.config, 'CACHE_DIR', str(self.cache))
        self.warnings: list[str] = []
        self.write()

    def write(self, caller: str = CALLER, callee: str = CALLEE) -> None:
        (self._sources / 'caller.py').write_text(caller)
        (self._sources / 'callee.py').write_text(callee)

    def compile(self) -> tuple[ModuleType, CompilationReport]:
        """Import both modules anew and compile their kernels; return the caller."""
        try:
            for name in ('callee', 'caller'):
                spec = importlib.util.spec_from_file_location(name, self._sources / f'{name}.py')
                assert spec is not None
                assert spec.loader is not None
                module = importlib.util.module_from_spec(spec)
                self._monkeypatch.setitem(sys.modules, name, module)
                exec(compile((self._sources / f'{name}.py').read_text(), spec.origin or '', 'exec'), vars(module))
            return module, compile_kernels(self.warnings.append)
        finally:
            kernels._pending[:] = [p for p in kernels._pending if p[0].__module__ not in ('callee', 'caller')]

    def files(self) -> list[Path]:
        """Return the files of the cache by the names of their kernels."""
        return sorted(path for path in self.cache.rglob('*') if path.is_file())


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sources:
    return Sources(tmp_path, monkeypatch)


def test_kernels_are_loaded_when_nothing_has_changed(sources: Sources) -> None:
    module, first = sources.compile()
    assert module.advance(1.0) == 2.0
    module, second = sources.compile()
    assert module.advance(1.0) == 2.0
    assert (first.kernels, first.compiled) == (3, 3)
    assert (second.kernels, second.compiled) == (3, 0)
    assert len(sources.warnings) == 1
    assert sources.warnings[0].startswith('compiling 3 functions')


@pytest.mark.parametrize(
    ('changed', 'result', 'compiled'),
    [
        ({'caller': CALLER.replace('add(value, STEP)', 'add(value, 2 * STEP)')}, 3.0, 1),
        ({'caller': CALLER.replace('STEP = 1.0', 'STEP = 4.0')}, 5.0, 1),
        ({'caller': CALLER.replace('LIMITS = (0.0', 'LIMITS = (7.0')}, 9.0, 1),
        ({'callee': CALLEE.replace('a + b', 'a - b')}, 0.0, 2),
        ({'callee': CALLEE.replace('5.0', '6.0')}, 2.0, 0),
    ],
    ids=['kernel', 'constant', 'tuple', 'called kernel', 'function that is not called'],
)
def test_what_has_changed_is_compiled_anew(
    sources: Sources, changed: dict[str, str], result: float, compiled: int
) -> None:
    sources.compile()
    sources.write(**changed)
    module, report = sources.compile()
    assert module.advance(1.0) == result
    assert report.compiled == compiled
    assert len(sources.files()) == 3  # outdated files are removed


def test_kernels_of_one_function_for_two_signatures_are_kept_side_by_side(sources: Sources) -> None:
    signatures = 'kernel(INT(INT))(halve)', 'kernel(FLOAT(FLOAT))(halve)'
    halves = f'def halve(value):\n    return value / 2\n\nin_ints, in_floats = {", ".join(signatures)}\n'
    sources.write(callee='from mocap_ros.compiled.kernel import INT\n' + CALLEE + '\n' + halves)
    sources.compile()
    _, report = sources.compile()
    assert (report.kernels, report.compiled) == (5, 0)


def test_a_changed_function_that_is_no_kernel_is_noticed(sources: Sources) -> None:
    caller = CALLER.replace('+ LIMITS[0]', '+ inner_limit()').replace('STEP = 1.0', 'STEP = 1.0\n' + INLINED)
    sources.write(caller)
    module, _ = sources.compile()
    assert module.advance(1.0) == 8.0
    sources.write(caller.replace('6.0', '7.0'))
    module, report = sources.compile()
    assert module.advance(1.0) == 9.0
    assert report.compiled == 1


INLINED = """
from numba.extending import register_jitable

@register_jitable
def inner_limit():
    return 6.0
"""


@pytest.mark.parametrize('damage', ['empty', 'truncated', 'one bit', 'not a kernel'])
def test_a_damaged_file_is_replaced(sources: Sources, damage: str) -> None:
    sources.compile()
    for file in sources.files():
        content = file.read_bytes()
        damaged = {
            'empty': b'',
            'truncated': content[: len(content) // 2],
            'one bit': content[:5000] + bytes([content[5000] ^ 1]) + content[5001:],
            'not a kernel': b'x' * 100,
        }
        file.write_bytes(damaged[damage])
    module, report = sources.compile()
    assert module.advance(1.0) == 2.0
    assert report.compiled == 3
    assert sources.compile()[1].compiled == 0


@pytest.mark.parametrize(
    ('owner', 'name', 'value'),
    [(numba.config, 'BOUNDSCHECK', 1), (numba, '__version__', '0.0'), (llvmlite, '__version__', '0.0')],
    ids=['option', 'Numba', 'LLVM'],
)
def test_other_options_and_versions_of_the_compiler_have_files_of_their_own(
    sources: Sources, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, value: object
) -> None:
    sources.compile()
    with monkeypatch.context() as changed:
        changed.setattr(owner, name, value)
        assert sources.compile()[1].compiled == 3
    assert sources.compile()[1].compiled == 0
    assert len(sources.files()) == 6


def test_without_a_folder_every_start_compiles_and_says_so(sources: Sources) -> None:
    sources.cache.write_text('a file where the folder should be')
    for _ in range(2):
        module, report = sources.compile()
        assert module.advance(1.0) == 2.0
        assert report.compiled == 3
    assert len(sources.warnings) == 4
    assert 'Not a directory), so every start compiles them: set the environment variable' in sources.warnings[1]


def test_a_full_disk_leaves_nothing_behind(sources: Sources) -> None:
    with limit_file_size(1000):
        module, _ = sources.compile()
    assert module.advance(1.0) == 2.0
    assert 'File too large), so every start compiles them' in sources.warnings[1]
    assert not sources.files()


def test_a_kernel_with_a_large_constant_array_is_refused(sources: Sources) -> None:
    array = 'import numpy as np\nLIMITS = np.zeros(1_000_000)'
    sources.write(CALLER.replace('LIMITS = (0.0, 1.0)', array))
    with pytest.raises(ValueError, match='advance cannot be cached: pass arrays that are large or'):
        sources.compile()


COMPILE_IN_A_PROCESS = """
import sys
from mocap_ros.compiled.kernel import compile_kernels
import caller
report = compile_kernels(print)
print(caller.advance(1.0), report.kernels, report.compiled)
"""


def test_processes_share_the_cache_also_when_they_compile_at_once(sources: Sources) -> None:
    env = {
        **os.environ,
        'NUMBA_CACHE_DIR': str(sources.cache),
        'PYTHONPATH': f'{ROOT}{os.pathsep}{sources._sources}',
    }
    command = [sys.executable, '-c', COMPILE_IN_A_PROCESS]
    started = [subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    outputs = [process.communicate(timeout=120)[0].splitlines() for process in started]
    assert all(lines[-1].startswith('2.0 3') for lines in outputs)
    assert len(sources.files()) == 3
    later = subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=120)
    assert later.stdout == '2.0 3 0\n'
