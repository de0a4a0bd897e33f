"""Intrinsics that no camera can have are rejected."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics


@pytest.mark.parametrize('entry', [(0, 0, 1e200), (0, 0, 1e-200), (0, 2, 1e308), (1, 2, float('nan'))])
def test_impossible_camera_matrices_are_rejected(entry: tuple[int, int, float]) -> None:
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    matrix[entry[0], entry[1]] = entry[2]
    with pytest.raises(InputError, match=r'focal lengths|principal point'):
        Intrinsics.from_matrix(matrix)
