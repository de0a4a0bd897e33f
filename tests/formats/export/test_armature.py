"""The armature of a motion; `tests/runtime/test_save_results.py` compares its joints with the motion."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.formats.export.armature import build_armature


@pytest.mark.filterwarnings('error')
def test_degenerate_bodies_give_finite_angles() -> None:
    point = np.zeros((3, 15, 3))
    line = np.repeat(np.linspace([0, 0, 0], [0, 2, 0], 15)[None], 3, axis=0)
    for joints in (point, line):
        assert np.isfinite(build_armature(joints, 30.0).motion).all()
