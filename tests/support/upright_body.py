# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A body that stands upright with hanging arms, as its segments' axes are defined by it; angles of directions."""

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import CMU15

_HALF = {'shoulder': (0.18, 1.42), 'elbow': (0.18, 1.14), 'wrist': (0.18, 0.88), 'hip': (0.09, 0.92)}
_HALF |= {'knee': (0.09, 0.5), 'ankle': (0.09, 0.08)}  # m to the side, m above the floor
_MIDDLE = {'head': 1.65, 'neck': 1.48, 'pelvis': 1.0}  # m above the floor
# m, (15, 3) of `CMU15`: x forward, y to the left, z up
UPRIGHT = np.array(
    [
        (0.0, 0.0, _MIDDLE[name])
        if name in _MIDDLE
        else (0.0, _HALF[name[1:]][0] * (1 if name[0] == 'l' else -1), _HALF[name[1:]][1])
        for name in CMU15.joints
    ]
)


def angles_deg(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles (...) between directions (..., 3) of any length."""
    norms = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=-1) / norms, -1, 1)))
