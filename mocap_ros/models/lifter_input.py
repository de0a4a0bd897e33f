# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the lifter's network sees: the last 0.8 s of a person's image points, and the vertical where it is known.

    x_tj = (1 - a) x_before + a x_after        points at the slots' times (`sample_histories`)
    c_t = sum_j w_tj x_tj / sum_j w_tj         centroid of a slot, over the joints of the core
    u = sum_tj w_tj |x_tj - c_t| / sum_tj w_tj      unit of the features: mean distance from the centroids
    k = S^2 / (S^2 + s_v^2)                    certainty of the vertical v, of standard deviation s_v
    features: (x_tj - c_t) / u and w_tj of each slot and joint, k v, and the angular size u / f

The core are the joints of `skeleton.CMU15`, the first of `skeleton.BODY26`: every detector gives them, so that the
centroid and the unit do not depend on which of the others it gives.

Shapes: N histories, T slots, J joints of `skeleton.BODY26`, F frames.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.engine import lifter as engine
from mocap_ros.skeleton import BODY26, CORE_COUNT

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# s before the newest frame at which a history is sampled; dense for recent frames, sparse for older ones. A lifter
# can only be used with the slots that it was trained with.
HISTORY_SLOTS_S = np.array([0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 24]) / 30

MAX_INTERPOLATION_GAP_S = 0.15  # s; points in longer gaps between frames count as not seen, as in training
TIME_TOLERANCE_S = 0.004  # s; a frame this near to a slot is taken as it is, an eighth of a frame at 30 fps
# rad; S: about how far the lifter's own guess of the vertical is off; a better one counts by more than half
VERTICAL_STD_RAD = math.radians(8.0)

JOINT_COUNT = len(BODY26.joints)  # joints
MIRROR_PERMUTATION = np.array(BODY26.mirror)  # joint indices with left and right exchanged
POINT_FEATURES = 3 * JOINT_COUNT * len(HISTORY_SLOTS_S)  # x, y and score of each joint and slot
FEATURE_COUNT = POINT_FEATURES + 4  # these, the vertical and the angular size


def sample_histories(points: Array, weight: Array, times: Array, frames: NDArray[np.intp]) -> tuple[Array, Array]:
    """Sample a sequence at T slots for each of N frames: at the frame's time minus `HISTORY_SLOTS_S`.

    The frame nearest to a slot is taken as it is if it is within `TIME_TOLERANCE_S`. At other slots, the point and
    the score of a joint are interpolated between the frames before and after the slot if the joint was seen in
    both and they are at most `MAX_INTERPOLATION_GAP_S` apart. Otherwise the joint counts as not seen.

    Args:
        points: (F, J, 2) image points in any unit; ignored where the weight is 0.
        weight: (F, J) confidence scores, 0 for joints that were not seen.
        times: (F,) s, increasing.
        frames: (N,) indices of the newest frame of each history.

    Returns:
        (N, T, J, 2) image points and (N, T, J) confidence scores, newest slot first; both are 0 for joints that
        were not seen.
    """
    return engine.sample_histories(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(weight, float),
        np.ascontiguousarray(times, float),
        np.ascontiguousarray(frames, np.int64),
        HISTORY_SLOTS_S,
        MAX_INTERPOLATION_GAP_S,
        TIME_TOLERANCE_S,
    )


class NetworkInput(NamedTuple):
    """Histories of N people or frames as the network gets them.

    Attributes:
        features: (N, 2, FEATURE_COUNT) features of each history and of its mirror image.
        newest: (N, J, 2) newest points as in the features, 0 for joints not seen.
        size: (N,) unit of these points, the mean distance from the centroid, in the unit of the image points.
        rotation: (N, 3, 3) rotations from the camera's frame to those of the virtual cameras.
    """

    features: Array32
    newest: Array
    size: Array
    rotation: Array


def encode_histories(
    points: Array, weight: Array, focal: float, vertical: Array | None = None, vertical_std: Array | None = None
) -> NetworkInput:
    """Convert histories to the input of the network, seen by virtual cameras that face the newest points.

    Args:
        points: (N, T, J, 2) image points in any unit, or (N, T, J_c, 2) without face, feet and hands; ignored
            where the weight is 0. If `focal` is finite they are relative to the optical axis.
        weight: (N, T, J) or (N, T, J_c) confidence scores, 0 for joints that were not seen.
        focal: focal length of the camera in the unit of the points; infinite if unknown, which leaves out the
            virtual cameras.
        vertical: (N, 3) unit vectors upwards in the axes of the camera that took the points; NaN or None where
            unknown.
        vertical_std: (N,) rad, their standard deviations.
    """
    upward = np.zeros((len(weight), 3))
    if vertical is not None and vertical_std is not None:
        upward = weigh_vertical(vertical, vertical_std)
    return NetworkInput(
        *_encode(points, weight, np.full(len(weight), focal), upward, turns_cameras=True, images=2)
    )


def _encode(
    points: Array, weight: Array, focal: Array, upward: Array, *, turns_cameras: bool, images: int
) -> tuple[Array32, Array, Array, Array]:
    return engine.encode(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(weight, float),
        np.ascontiguousarray(focal, float),
        np.ascontiguousarray(upward, float),
        MIRROR_PERMUTATION,
        CORE_COUNT,
        turns_cameras,
        images,
    )


def weigh_vertical(vertical: Array, std: Array) -> Array:
    """Return k v (N, 3) of verticals (N, 3) with standard deviations (N,) in rad; 0 where v is unknown."""
    certainty = VERTICAL_STD_RAD**2 / (VERTICAL_STD_RAD**2 + std**2)
    return np.nan_to_num(vertical * certainty[:, None])


def encode_features(points: Array32, weight: Array32, focal: Array, upward: Array) -> tuple[Array32, Array, Array]:
    """Convert histories that virtual cameras see already to features, as for training.

    Args:
        points: (N, T, J, 2) image points in any unit; ignored where the weight is 0.
        weight: (N, T, J) confidence scores, 0 for joints that were not seen.
        focal: (N,) focal lengths in the unit of the points; infinite if unknown.
        upward: (N, 3) what `weigh_vertical` returns, in the axes of the virtual cameras.

    Returns:
        (N, FEATURE_COUNT) features; `newest` and `size` as in `NetworkInput`.
    """
    given = np.asarray(points, float), np.asarray(weight, float), focal, upward
    features, newest, size, _ = _encode(*given, turns_cameras=False, images=1)
    return features[:, 0], newest, size
