# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The compilation of all kernels, and what it must know of."""

from __future__ import annotations

import re
import subprocess
import sys

from mocap_ros.compiled.__main__ import DECLARING_MODULES, compile_all
from tests.support.paths import ROOT

LIST_MODULES = (
    'import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]; print(*sys.modules)'
)


def test_it_says_how_many_functions_are_ready() -> None:
    assert re.fullmatch(
        r'\d+ compiled functions are ready after \d+\.\d s, \d+ from the cache', str(compile_all())
    )


def test_it_knows_all_modules_with_kernels() -> None:
    declaring = {
        '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        for path in (ROOT / 'mocap_ros').rglob('*.py')
        if re.search(r'^@kernel\(', path.read_text(encoding='utf-8'), re.MULTILINE)
    }
    command = [sys.executable, '-c', LIST_MODULES, *DECLARING_MODULES]
    imported = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    assert declaring
    assert declaring <= set(imported)
