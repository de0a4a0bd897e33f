# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints that cannot be used are found with their field and index."""

from __future__ import annotations

import numpy as np

from mocap_ros.keypoints.validation import find_first_fault


def test_a_point_far_outside_any_image_is_a_fault() -> None:
    points = np.full((5, 2), 100.0)
    assert find_first_fault(points, np.ones(5)) is None
    points[3, 1] = 1e10
    fault = find_first_fault(points, np.ones(5))
    assert fault is not None
    assert (fault.field, fault.index) == ('y', (3,))
