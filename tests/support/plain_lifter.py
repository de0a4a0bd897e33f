# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifter in plain NumPy and double precision, which the compiled one is compared with."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.virtual_camera import rotate_rays, rotation_to_optical_axis
from mocap_ros.models import lifter, lifter_input
from mocap_ros.skeleton import BODY26, CORE_COUNT

Layers = Sequence[tuple[Any, Any]]
MIRROR = list(BODY26.mirror)
CORE = slice(CORE_COUNT)
MAX_FEATURE = 5.0  # mean distances from the centroid
MAX_COORDINATE = 1e12  # larger coordinates count as not seen
ANGULAR_SIZE_UNIT_RAD = 0.1
MIN_TOTAL_WEIGHT = 1e-9
MIN_SEEN_JOINTS = 3  # of the core in the newest frame; with fewer there is no pose
UNKNOWN = np.zeros(3)  # what the network is told of a vertical that is not known


def sample_history(points: Array, weight: Array, times: Array, newest: int) -> tuple[Array, Array]:
    """Return one history as `lifter_input.sample_histories` does: points (T, J, 2) and weights (T, J)."""
    slots = len(lifter_input.HISTORY_SLOTS_S)
    sampled_points, sampled_weight = np.zeros((slots, *points.shape[1:])), np.zeros((slots, weight.shape[1]))
    for slot, time in enumerate(times[newest] - lifter_input.HISTORY_SLOTS_S):
        (late,) = np.nonzero(times[: newest + 1] >= time - lifter_input.TIME_TOLERANCE_S)
        before, after = max(late[0] - 1, 0), late[0]
        nearest = int(np.abs(times[: newest + 1] - time).argmin())
        if abs(times[nearest] - time) <= lifter_input.TIME_TOLERANCE_S:
            shares = {nearest: 1.0}
        elif after == 0 or times[after] - times[before] > lifter_input.MAX_INTERPOLATION_GAP_S:
            continue
        else:
            share = (time - times[before]) / (times[after] - times[before])
            shares = {before: 1 - share, after: share}
        seen = (weight[list(shares)] > 0).all(axis=0)
        sampled_weight[slot, seen] = sum(share * weight[f, seen] for f, share in shares.items())
        sampled_points[slot, seen] = sum(share * points[f, seen] for f, share in shares.items())
    return sampled_points, sampled_weight


def weigh_vertical(vertical: Array, std: float) -> Array:
    """Return what the network is told of a vertical (3,) with a standard deviation in rad."""
    return vertical * lifter_input.VERTICAL_STD_RAD**2 / (lifter_input.VERTICAL_STD_RAD**2 + std**2)


def encode_features(
    points: Array, weight: Array, focal: float, upward: Array = UNKNOWN
) -> tuple[Array, Array, float]:
    """Return the features of one history (T, J, 2) in virtual cameras, its newest points (J, 2) and its unit."""
    seen = (weight > 0) & (np.abs(points) < MAX_COORDINATE).all(axis=-1)
    weight = np.where(seen, np.minimum(weight, 1), 0)
    clean = np.where(seen[..., None], points, 0)
    core = weight[:, CORE]
    total = np.maximum(core.sum(axis=1), MIN_TOTAL_WEIGHT)
    centroid = (core[..., None] * clean[:, CORE]).sum(axis=1) / total[:, None]
    centred = np.where(seen[..., None], clean - centroid[:, None], 0)
    distances = np.linalg.norm(centred[:, CORE], axis=-1)
    unit = float((core * distances).sum() / max(core.sum(), MIN_TOTAL_WEIGHT))
    unit = unit if unit > 0 else 1.0
    relative = np.clip(centred / unit, -MAX_FEATURE, MAX_FEATURE)
    angular_size = min(unit / focal / ANGULAR_SIZE_UNIT_RAD, MAX_FEATURE)
    return np.concatenate([np.dstack([relative, weight]).ravel(), upward, [angular_size]]), relative[0], unit


def mirror_features(features: Array) -> Array:
    """Return the features of the mirror image: x negated, left and right joints exchanged."""
    block = features[:-4].reshape(-1, len(MIRROR), 3)[:, MIRROR] * [-1, 1, 1]
    return np.concatenate([block.ravel(), features[-4:] * [-1, 1, 1, 1]])


def face_newest_points(points: Array, weight: Array, focal: float) -> tuple[Array, Array]:
    """Return one history (T, J, 2) in the image of a camera that faces its newest points, and its rotation."""
    seen = (weight > 0) & (np.abs(points) < MAX_COORDINATE).all(axis=-1)
    clean = np.where(seen[..., None], points, 0) / focal
    newest = np.where(seen[0], weight[0], 0)[CORE]
    rotation = rotation_to_optical_axis((newest @ clean[0, CORE] / max(newest.sum(), 1e-9))[None])[0]
    return np.where(seen[..., None], focal * rotate_rays(clean, rotation), np.nan), rotation


def round_layers(layers: Layers) -> list[tuple[Any, Any]]:
    """Return layers with the weights of each input rounded to multiples: of 1/127 of the largest, or 1/32767."""
    rounded = []
    for number, (given, bias) in enumerate(layers):
        weights = np.asarray(given, np.float32)
        largest = 127 if 0 < number < len(layers) - 1 else 32767
        step = np.abs(weights).max(axis=1, keepdims=True) / largest
        rounded.append((np.where(step > 0, step * np.round(weights / np.maximum(step, 1e-30)), 0), bias))
    return rounded


def evaluate(layers: Layers, features: NDArray[Any]) -> Array:
    """Return the outputs (..., O) of the network for features (..., I)."""
    (first, bias), *hidden, (last, last_bias) = [(w.astype(float), b.astype(float)) for w, b in layers]
    h = np.maximum(features @ first + bias, 0)
    for (a, b), (c, d) in zip(hidden[::2], hidden[1::2], strict=True):
        h = h + np.maximum(np.maximum(h @ a + b, 0) @ c + d, 0)
    return np.asarray(h @ last + last_bias)


def lift(
    layers: Layers, points: Array, weight: Array, focal: float, vertical: tuple[Array, float] | None = None
) -> tuple[Array, Array]:
    """Return the lifted pose (J, 3) of one history and its standard deviations (J, 3)."""
    rotation = np.eye(3)
    if np.isfinite(focal):
        points, rotation = face_newest_points(points, weight, focal)
    upward = UNKNOWN if vertical is None else weigh_vertical(rotation @ vertical[0], vertical[1])
    features, newest, unit = encode_features(points, weight, focal, upward)
    if (features[2 : 3 * CORE_COUNT : 3] > 0).sum() < MIN_SEEN_JOINTS:
        return np.full((len(MIRROR), 3), np.nan), np.full((len(MIRROR), 3), np.nan)
    outputs = evaluate(layers, np.stack([features, mirror_features(features)]))
    pose, mirrored = outputs[:, : 3 * len(MIRROR)].reshape(2, -1, 3)
    log_std, mirrored_log_std = outputs[:, 3 * len(MIRROR) :].reshape(2, -1, 2)
    pose = (pose + mirrored[MIRROR] * [-1, 1, 1]) / 2
    pose[:, :2] += newest
    std = np.exp(np.clip((log_std + mirrored_log_std[MIRROR]) / 2, *lifter.LOG_STD_RANGE))
    return (pose - pose[CORE].mean(axis=0)) @ rotation * unit, std[:, [0, 0, 1]] * unit
