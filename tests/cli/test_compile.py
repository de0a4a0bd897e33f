# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command that compiles, and what it must know of."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from mocap_ros.cli.compile import DECLARING_MODULES
from mocap_ros.cli.main import main
from tests.support.paths import ROOT

LIST_MODULES = (
    'import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]; print(*sys.modules)'
)


def test_it_says_how_many_functions_are_ready(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['compile']) == 0
    assert re.fullmatch(
        r'\d+ compiled functions are ready after \d+\.\d s, \d+ from the cache\n', capsys.readouterr().out
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
