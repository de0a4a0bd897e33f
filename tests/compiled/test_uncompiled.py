# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The same code without Numba's compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np

from tests.support.paths import ROOT
from tests.support.tiny_problems import solve_all

# m, by problem; sums in BLAS and in loops have another order, in the network those of float32
TOLERANCES_M = {'window': 1e-9, 'person': 1e-6}


def test_uncompiled_code_gives_the_same_results() -> None:
    finished = subprocess.run(
        [sys.executable, '-m', 'tests.support.tiny_problems'],
        cwd=ROOT,
        env={**os.environ, 'NUMBA_DISABLE_JIT': '1'},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    uncompiled, compiled = json.loads(finished.stdout), solve_all()
    assert uncompiled.keys() == compiled.keys() == TOLERANCES_M.keys()
    for name, joints in compiled.items():
        assert np.isfinite(joints).all()
        np.testing.assert_allclose(uncompiled[name], joints, rtol=0, atol=TOLERANCES_M[name], err_msg=name)
