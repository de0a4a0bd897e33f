# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Velocities of points in a smooth motion, by central differences.

v(t_i) = (x(t_{i+1}) - x(t_{i-1})) / (t_{i+1} - t_{i-1})
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_STEP_S = 0.2  # s; over a longer gap between two frames a limb may have swung to and fro


def central_velocity(times: Array, points: Array) -> Array:
    """Return the velocities (F, ..., 3) in m/s of points in a smooth motion.

    They are NaN in the first and the last frame, beside frames without points, and beside gaps of more than
    `MAX_STEP_S`.

    Args:
        times: (F,) s, increasing.
        points: (F, ..., 3) m; NaN where they are not known.
    """
    velocity = np.full(points.shape, np.nan)
    if len(times) > 2:
        steps = np.diff(times)
        near = np.flatnonzero((steps[:-1] <= MAX_STEP_S) & (steps[1:] <= MAX_STEP_S)) + 1
        spans = (times[near + 1] - times[near - 1]).reshape(-1, *[1] * (points.ndim - 1))
        velocity[near] = (points[near + 1] - points[near - 1]) / spans
    return velocity
