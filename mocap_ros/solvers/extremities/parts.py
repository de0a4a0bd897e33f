# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The rigid parts, their points, and how they hang on the core.

    p_i = c_k + e^(b_k) H R_k T_i

with the template T_i of an average person (1 of the stature), the stature H (m) and the person's logarithmic size
b_k of face, feet or hands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26, CORE_COUNT
from mocap_ros.solvers.body_segments import PART_SEGMENTS, rotation_about

Array = NDArray[np.float64]

EXTREMITIES = BODY26.joints[CORE_COUNT:]
PARTS = ('head', 'lfoot', 'rfoot', 'lhand', 'rhand')
PART_COUNT = len(PARTS)
HEAD = 0  # index of the part

# Points (m per m of stature) in the axes of their part: the mean of the people of the training data. The line from
# the ears to the nose is 19.6 degrees below the horizontal in people who walk.
_FACE_PITCH = rotation_about(1, 19.6)
_TEMPLATES = {
    'toe': (0.115, 0.0, -0.0314),
    'heel': (-0.0307, 0.0, -0.0314),
    'hand': (0.0, 0.0, -0.0433),
    'nose': tuple(_FACE_PITCH @ (0.0710, 0.0, -0.0283)),
    'leye': tuple(_FACE_PITCH @ (0.0583, 0.0188, -0.0098)),
    'reye': tuple(_FACE_PITCH @ (0.0583, -0.0188, -0.0098)),
    'lear': tuple(_FACE_PITCH @ (0.0110, 0.0441, -0.0283)),
    'rear': tuple(_FACE_PITCH @ (0.0110, -0.0441, -0.0283)),
}
TEMPLATE = np.array([_TEMPLATES.get(name, _TEMPLATES.get(name[1:])) for name in EXTREMITIES])
# index of the part of each point
PART_OF = np.array(
    [
        HEAD
        if n == 'nose' or n[1:] in ('eye', 'ear')
        else PARTS.index(n[0] + ('hand' if n[1:] == 'hand' else 'foot'))
        for n in EXTREMITIES
    ]
)
POINT_COUNTS = np.bincount(PART_OF)  # N
ANCHORS = PART_SEGMENTS[PART_OF]  # (11,) index of the core joint on which each point hangs
# (26,) index of the segment that turns about each joint or holds it
SEGMENT_OF = np.concatenate([np.arange(CORE_COUNT), ANCHORS])
SIZE_OF = np.array([0, 1, 1, 2, 2])  # parts of one size: face, feet, hands
SIZE_COUNT = 3
# rad; S, standard deviations of head, feet and hands about x, y, z from where the core has them, in the training
# data; those of feet are a quarter wider, as solved shanks are worse than true ones. The turn of a hand about its
# own axis, which nothing measures, is chosen by judgement.
REST_STD = np.radians(
    [[8.0, 14.0, 22.0], [10.0, 18.0, 26.0], [10.0, 18.0, 26.0], [20.0, 20.0, 30.0], [20.0, 20.0, 30.0]]
)
REST_MEMORY_S = np.array([0.7, 0.4, 0.4, 0.4, 0.4])  # s; tau: half a step for feet, a look for heads
# 1; s_b: std of b of face, feet and hands in the training data, and of what detectors take for toe and hand
SIZE_STD = np.array([0.06, 0.12, 0.15])


def attach(core: Array, offsets: Array) -> Array:
    """Return all joints (..., 26, 3) m of core joints (..., 15, 3) and offsets (..., 11, 3) of extremities."""
    return np.concatenate([core, core[..., ANCHORS, :] + offsets], axis=-2)
