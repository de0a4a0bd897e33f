"""The same code without Numba's compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np

from tests.support.paths import ROOT
from tests.support.tiny_problems import solve_all

TOLERANCE_M = 1e-9  # m; sums in BLAS and in loops have another order


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
    assert uncompiled.keys() == compiled.keys()
    for name, joints in compiled.items():
        assert np.isfinite(joints).all()
        np.testing.assert_allclose(uncompiled[name], joints, rtol=0, atol=TOLERANCE_M, err_msg=name)
