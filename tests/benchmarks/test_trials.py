# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The trials that the benchmarks name are in the motion capture that they use."""

from __future__ import annotations

import re
from pathlib import Path

import common
import numpy as np
import pytest

from tests.support.paths import ROOT

NAME = re.compile(r"'([0-9A-Z]{2,3}_\d\dx?)'")
ON_MOTION = ('golden.py', 'tracker.py')
FILES = [f for f in sorted((ROOT / 'benchmarks').glob('*.py')) if NAME.search(f.read_text(encoding='utf-8'))]


@pytest.mark.parametrize('file', FILES, ids=lambda f: f.name)
def test_every_trial_that_a_benchmark_names_exists(file: Path) -> None:
    capture = 'motion' if file.name in ON_MOTION else 'cmu'
    path = common.data_path('data', *common.CAPTURE_FILES[capture])
    if not path.is_file():
        pytest.skip(f'needs {path}')
    with np.load(path) as archive:
        assert set(NAME.findall(file.read_text(encoding='utf-8'))) <= set(archive.files)
