# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Vectors over time: linear interpolation, central differences, and the nearest of some times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Mask
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation

ROUNDING_S = 1e-6  # s; times that differ by less are equal
MAX_STEP_S = 0.2  # s; over a longer gap between two frames a limb may have swung to and fro


def find_nearest(times: Array, known: Array) -> NDArray[np.intp]:
    """Return for each time (N,) the index of the nearest of others (n,), increasing; of two the earlier."""
    after = np.minimum(np.searchsorted(known, times), len(known) - 1)
    before = np.maximum(after - 1, 0)
    is_after_nearer = np.abs(times - known[after]) < np.abs(times - known[before])
    return np.where(is_after_nearer, after, before)


def find_covered(times: Array, known: Array) -> Mask:
    """Return whether each time (N,) is one of others (n,), increasing, or between two not far apart."""
    before = np.searchsorted(known, times + ROUNDING_S, side='right') - 1
    after = np.searchsorted(known, times - ROUNDING_S)
    is_covered = (before >= 0) & (after < len(known))
    is_covered[is_covered] = known[after[is_covered]] - known[before[is_covered]] <= MAX_STEP_S
    return is_covered


def interpolate_linearly(times: Array, sample_times: Array, samples: Array) -> Array:
    """Return samples (n, ...) of increasing times interpolated at times (N,); the ends hold beyond them."""
    if len(sample_times) == 1:
        return np.repeat(samples, len(times), axis=0)
    left = sample_times[1:-1].searchsorted(times)
    share = (times - sample_times[left]) / (sample_times[left + 1] - sample_times[left])
    share = np.minimum(np.maximum(share, 0), 1).reshape(-1, *[1] * (samples.ndim - 1))
    return np.asarray((1 - share) * samples[left] + share * samples[left + 1])


def central_velocity(times: Array, points: Array) -> Array:
    """v(t_i) = (x(t_{i+1}) - x(t_{i-1})) / (t_{i+1} - t_{i-1}), NaN at ends and beside gaps above `MAX_STEP_S`."""
    velocity = np.full(points.shape, np.nan)
    if len(times) > 2:
        steps = np.diff(times)
        near = np.flatnonzero((steps[:-1] <= MAX_STEP_S) & (steps[1:] <= MAX_STEP_S)) + 1
        spans = (times[near + 1] - times[near - 1]).reshape(-1, *[1] * (points.ndim - 1))
        velocity[near] = (points[near + 1] - points[near - 1]) / spans
    return velocity


def interpolate_rotations(times: Array, known_times: Array, rotations: Array) -> Array:
    """R(t) = exp(s log(R_(k+1) R_k^T)) R_k, s = (t - t_k) / (t_(k+1) - t_k), between known rotations R_k."""
    before = np.clip(np.searchsorted(known_times, times, side='right') - 1, 0, len(known_times) - 2)
    share = (times - known_times[before]) / np.diff(known_times)[before]
    turns = vector_from_rotation(rotations[1:] @ np.swapaxes(rotations[:-1], -1, -2))[before]
    return np.asarray(rotation_from_vector(share[:, None] * turns) @ rotations[before])
