# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations that make a tilted camera level."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.level import LEVEL_UP, average_vertical, rotation_to_level

ANGLES = st.floats(-180, 180)


@given(ANGLES, ANGLES)
@example(180.0, 0.0)
@example(180.0, 0.002)
@example(180.0, 1e-7)
def test_the_vertical_becomes_that_of_a_level_camera_by_the_smallest_turn(pitch: float, roll: float) -> None:
    vertical = Rotation.from_euler('xz', [pitch, roll], degrees=True).apply(LEVEL_UP)
    rotation = rotation_to_level(vertical)
    assert rotation @ vertical == pytest.approx(LEVEL_UP, abs=1e-11)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    angle = np.arctan2(np.linalg.norm(np.cross(vertical, LEVEL_UP)), vertical @ LEVEL_UP)
    assert Rotation.from_matrix(rotation).magnitude() == pytest.approx(angle, abs=1e-11)


def test_an_unknown_vertical_leaves_everything_as_it_is() -> None:
    assert (rotation_to_level(np.full(3, np.nan)) == np.eye(3)).all()


def test_the_mean_leaves_out_what_is_not_known() -> None:
    vertical = np.array([[0.6, -0.8, 0], [-0.6, -0.8, 0], [np.nan] * 3])
    assert average_vertical(vertical) == pytest.approx(LEVEL_UP)
    assert np.isnan(average_vertical(vertical[2:])).all()
    assert np.isnan(average_vertical(np.empty((0, 3)))).all()
