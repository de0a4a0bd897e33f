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
from numba import float32, types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOL,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    FLOATS_4D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_4D,
    INPUT_INTS_1D,
    kernel,
)
from mocap_ros.geometry.virtual_camera import rotate_ray, rotation_to_optical_axis
from mocap_ros.skeleton import BODY26, CORE_COUNT

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# s before the newest frame at which a history is sampled; dense for recent frames, sparse for older ones. A lifter
# can only be used with the slots that it was trained with.
HISTORY_SLOTS_S = np.array([0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 24]) / 30

MAX_INTERPOLATION_GAP_S = 0.15  # s; points in longer gaps between frames count as not seen, as in training
TIME_TOLERANCE_S = 0.004  # s; a frame this near to a slot is taken as it is, an eighth of a frame at 30 fps
MAX_FEATURE = 5.0  # mean distances from the centroid; bounds the effect of gross outliers on the network
MAX_COORDINATE = 1e12  # units of the input; larger coordinates count as not seen, their squares could overflow
ANGULAR_SIZE_UNIT_RAD = 0.1  # rad; brings the angular size of a person at usual distances to the order of 1
MIN_TOTAL_WEIGHT = 1e-9  # 1; guards divisions by sums of confidence scores

# rad; S: about how far the lifter's own guess of the vertical is off; a better one counts by more than half
VERTICAL_STD_RAD = math.radians(8.0)

JOINT_COUNT = len(BODY26.joints)  # joints
MIRROR_PERMUTATION = np.array(BODY26.mirror)  # joint indices with left and right exchanged
POINT_FEATURES = 3 * JOINT_COUNT * len(HISTORY_SLOTS_S)  # x, y and score of each joint and slot
FEATURE_COUNT = POINT_FEATURES + 4  # these, the vertical and the angular size

_FLOATS32_3D = types.Array(float32, 3, 'C')  # types of kernels' arguments


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
    sampled_weight = np.zeros((len(frames), len(HISTORY_SLOTS_S), weight.shape[1]))
    sampled_points = np.zeros((*sampled_weight.shape, 2))
    _sample(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(weight, float),
        np.ascontiguousarray(times, float),
        np.ascontiguousarray(frames, np.int64),
        sampled_points,
        sampled_weight,
    )
    return sampled_points, sampled_weight


@kernel(void(INPUT_3D, INPUT_2D, INPUT_1D, INPUT_INTS_1D, FLOATS_4D, FLOATS_3D))
def _sample(
    points: Array,
    weight: Array,
    times: Array,
    frames: NDArray[np.int64],
    sampled_points: Array,
    sampled_weight: Array,
) -> None:
    """Write what `sample_histories` returns into arrays that hold 0."""
    for n in range(len(frames)):
        after = frames[n]
        for slot in range(len(HISTORY_SLOTS_S)):
            time = times[frames[n]] - HISTORY_SLOTS_S[slot]
            while after > 0 and times[after - 1] >= time - TIME_TOLERANCE_S:
                after -= 1
            before = max(after - 1, 0)
            to_after, to_before = times[after] - time, time - times[before]
            share = 0.0  # of the frame after the slot
            nearest = after
            while nearest < frames[n] and abs(times[nearest + 1] - time) < abs(times[nearest] - time):
                nearest += 1
            if abs(times[nearest] - time) <= TIME_TOLERANCE_S:
                older, newer = nearest, nearest
            elif to_before > 0 and to_after + to_before <= MAX_INTERPOLATION_GAP_S:
                older, newer, share = before, after, to_before / (to_after + to_before)
            else:
                continue
            for j in range(weight.shape[1]):
                if weight[older, j] > 0 and weight[newer, j] > 0:
                    sampled_weight[n, slot, j] = (1 - share) * weight[older, j] + share * weight[newer, j]
                    for axis in range(2):
                        point = (1 - share) * points[older, j, axis] + share * points[newer, j, axis]
                        sampled_points[n, slot, j, axis] = point


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
    count = len(weight)
    points, weight = _add_missing_joints(points, weight)
    if math.isfinite(focal):
        points, rotation = _face_newest_points(points, weight, focal)
    else:
        rotation = np.empty((count, 3, 3))
        rotation[:] = np.eye(3)
    features = np.empty((count, 2, FEATURE_COUNT), np.float32)
    newest, size = np.empty((count, JOINT_COUNT, 2)), np.empty(count)
    upward = np.zeros((count, 3))
    if vertical is not None and vertical_std is not None:
        upward = weigh_vertical((rotation @ vertical[..., None])[..., 0], vertical_std)
    _encode(points, weight, np.full(count, focal), upward, features, newest, size)
    return NetworkInput(features, newest, size, rotation)


def _add_missing_joints(points: Array, weight: Array) -> tuple[Array, Array]:
    """Return histories of all joints; they may have those of the core alone."""
    if (missing := JOINT_COUNT - weight.shape[-1]) > 0:
        points = np.pad(points, [(0, 0), (0, 0), (0, missing), (0, 0)])
        weight = np.pad(weight, [(0, 0), (0, 0), (0, missing)])
    return np.ascontiguousarray(points, float), np.ascontiguousarray(weight, float)


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
    features = np.empty((len(weight), 1, FEATURE_COUNT), np.float32)
    newest, size = np.empty((len(weight), JOINT_COUNT, 2)), np.empty(len(weight))
    _encode(
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(weight, float),
        np.ascontiguousarray(focal, float),
        np.ascontiguousarray(upward, float),
        features,
        newest,
        size,
    )
    return features[:, 0], newest, size


@kernel(BOOL(FLOAT, FLOAT, FLOAT))
def _is_seen(x: float, y: float, weight: float) -> bool:
    return weight > 0 and abs(x) < MAX_COORDINATE and abs(y) < MAX_COORDINATE


@kernel(types.Tuple((FLOATS_4D, FLOATS_3D))(INPUT_4D, INPUT_3D, FLOAT))
def _face_newest_points(points: Array, weight: Array, focal: float) -> tuple[Array, Array]:
    """Return histories in virtual cameras that face their newest points, and the rotations (N, 3, 3) of these."""
    count, slots, joints = weight.shape
    directions = np.empty((count, 2))
    for n in range(count):
        total, x, y = 0.0, 0.0, 0.0
        for j in range(CORE_COUNT):
            w = weight[n, 0, j]
            if _is_seen(points[n, 0, j, 0], points[n, 0, j, 1], w):
                total, x, y = total + w, x + w * points[n, 0, j, 0], y + w * points[n, 0, j, 1]
        total = max(total, MIN_TOTAL_WEIGHT)
        directions[n, 0], directions[n, 1] = x / total / focal, y / total / focal
    rotation = rotation_to_optical_axis(directions)
    facing = np.full(points.shape, np.nan)
    for n in range(count):
        to_virtual = rotation[n]
        for slot in range(slots):
            for j in range(joints):
                x, y = points[n, slot, j, 0], points[n, slot, j, 1]
                if _is_seen(x, y, weight[n, slot, j]):
                    x, y = rotate_ray(to_virtual, x / focal, y / focal)
                    facing[n, slot, j, 0], facing[n, slot, j, 1] = focal * x, focal * y
    return facing, rotation


@kernel(FLOAT(INPUT_3D, INPUT_2D, FLOATS_3D, FLOATS_2D))
def _centre(points: Array, weight: Array, centred: Array, score: Array) -> float:
    """Write points (T, J, 2) relative to the centroids and scores (T, J), 0 if not seen, and return the unit."""
    total, total_distance = 0.0, 0.0
    for slot in range(len(weight)):
        slot_total, x, y = 0.0, 0.0, 0.0
        for j in range(weight.shape[1]):
            w = min(weight[slot, j], 1.0)
            score[slot, j] = 0.0
            if _is_seen(points[slot, j, 0], points[slot, j, 1], w):
                score[slot, j] = w
            if j < CORE_COUNT and score[slot, j] > 0:
                slot_total, x, y = slot_total + w, x + w * points[slot, j, 0], y + w * points[slot, j, 1]
        x, y = x / max(slot_total, MIN_TOTAL_WEIGHT), y / max(slot_total, MIN_TOTAL_WEIGHT)
        for j in range(weight.shape[1]):
            dx, dy, w = 0.0, 0.0, score[slot, j]
            if w > 0:
                dx, dy = points[slot, j, 0] - x, points[slot, j, 1] - y
                if j < CORE_COUNT:
                    total, total_distance = total + w, total_distance + w * math.sqrt(dx * dx + dy * dy)
            centred[slot, j, 0], centred[slot, j, 1] = dx, dy
    unit = total_distance / max(total, MIN_TOTAL_WEIGHT)
    return unit if unit > 0 else 1.0


@kernel(void(INPUT_4D, INPUT_3D, INPUT_1D, INPUT_2D, _FLOATS32_3D, FLOATS_3D, FLOATS_1D))
def _encode(
    points: Array, weight: Array, focal: Array, upward: Array, features: Array32, newest: Array, size: Array
) -> None:
    """Write the features of histories (N, 1, FEATURE_COUNT), or (N, 2, FEATURE_COUNT) with the mirror images."""
    count, slots, joints = weight.shape
    centred, score = np.empty((slots, joints, 2)), np.empty((slots, joints))
    for n in range(count):
        unit = _centre(points[n], weight[n], centred, score)
        size[n] = unit
        for image in range(features.shape[1]):
            row = features[n, image]
            row[POINT_FEATURES] = -upward[n, 0] if image else upward[n, 0]
            row[POINT_FEATURES + 1], row[POINT_FEATURES + 2] = upward[n, 1], upward[n, 2]
            row[-1] = min(unit / focal[n] / ANGULAR_SIZE_UNIT_RAD, MAX_FEATURE)
            for slot in range(slots):
                for j in range(joints):
                    x = min(max(centred[slot, j, 0] / unit, -MAX_FEATURE), MAX_FEATURE)
                    y = min(max(centred[slot, j, 1] / unit, -MAX_FEATURE), MAX_FEATURE)
                    first = 3 * (slot * joints + (MIRROR_PERMUTATION[j] if image else j))
                    row[first], row[first + 1], row[first + 2] = -x if image else x, y, score[slot, j]
                    if slot == 0:
                        newest[n, j, 0], newest[n, j, 1] = x, y
