# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the lifter's network sees: the last 0.8 s of a person's image points, and the vertical where it is known.

    x_tj = (1 - a) x_before + a x_after        points at the slots' times (`sample_histories`)
    c_t = sum_j w_tj x_tj / sum_j w_tj         centroid of a slot, over the joints of the core
    u = sum_tj w_tj |x_tj - c_t| / sum_tj w_tj      unit of the features: mean distance from the centroids
    k = S^2 / (S^2 + s_v^2)                    certainty of the vertical v, of standard deviation s_v
    features: (x_tj - c_t) / u and w_tj of each slot and joint, k v, and the angular size u / f

The core are the joints of `skeleton.CMU15`, which every detector gives. Shapes: N histories, T slots, J joints of
`skeleton.BODY26`, F frames.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Array32
from mocap_ros.engine import lifter as engine
from mocap_ros.skeleton import BODY26, CORE_COUNT

# s before the newest frame at which a history is sampled; dense for recent frames, sparse for older ones. A lifter
# can only be used with the slots that it was trained with.
HISTORY_SLOTS_S = np.array([0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 24]) / 30

MAX_INTERPOLATION_GAP_S = 0.15  # s; points in longer gaps between frames count as not seen, as in training
TIME_TOLERANCE_S = 0.004  # s; a frame this near to a slot is taken as it is, an eighth of a frame at 30 fps
SLOTS = HISTORY_SLOTS_S, MAX_INTERPOLATION_GAP_S, TIME_TOLERANCE_S
# rad; S: about how far the lifter's own guess of the vertical is off; a better one counts by more than half
VERTICAL_STD_RAD = math.radians(8.0)

JOINT_COUNT = len(BODY26.joints)  # joints
MIRROR_PERMUTATION = np.array(BODY26.mirror)  # joint indices with left and right exchanged
POINT_FEATURES = 3 * JOINT_COUNT * len(HISTORY_SLOTS_S)  # x, y and score of each joint and slot
FEATURE_COUNT = POINT_FEATURES + 4  # these, the vertical and the angular size


def sample_histories(points: Array, weight: Array, times: Array, frames: NDArray[np.intp]) -> tuple[Array, Array]:
    """Sample points (F, J, 2) and weights (F, J) for each of N frames, at their times minus `HISTORY_SLOTS_S`.

    The frame nearest to a slot is taken as it is within `TIME_TOLERANCE_S`. Otherwise a joint is interpolated
    between the frames before and after, if both show it and are at most `MAX_INTERPOLATION_GAP_S` apart; else it
    is not seen, 0 in both results (N, T, J, 2) and (N, T, J), newest slot first.
    """
    seen = np.ascontiguousarray(points, float), np.ascontiguousarray(weight, float)
    person = np.ascontiguousarray(times, float), frames.tolist(), np.eye(3)[None], [seen]
    return engine.sample_histories([person], weight.shape[1], *SLOTS)[:2]


def weigh_vertical(vertical: Array, std: Array) -> Array:
    """Return k v (N, 3) of verticals (N, 3) with standard deviations (N,) in rad; 0 where v is unknown."""
    certainty = VERTICAL_STD_RAD**2 / (VERTICAL_STD_RAD**2 + std**2)
    return np.nan_to_num(vertical * certainty[:, None])


def encode_features(points: Array32, weight: Array32, focal: Array, upward: Array) -> tuple[Array32, Array, Array]:
    """Convert histories that virtual cameras see already to features (N, FEATURE_COUNT), as for training.

    Focal lengths (N,) are in the unit of the points; `upward` (N, 3) is what `weigh_vertical` returns. The newest
    points (N, J, 2), as in the features, and the unit (N,) of these, in the unit of the points, are returned too.
    """
    features, newest, size, _ = engine.encode(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(weight, float),
        np.ascontiguousarray(focal, float),
        np.ascontiguousarray(upward, float),
        MIRROR_PERMUTATION,
        CORE_COUNT,
        False,
        1,
    )
    return features[:, 0], newest, size
