# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Arrays of training examples in single precision: random numbers, rotations, joints and trunks of bodies.

N examples, T slots of the history, J joints of `skeleton.BODY26`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.lifter_input import HISTORY_SLOTS_S
from mocap_ros.skeleton import BODY26

Array = NDArray[np.float32]
Array64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

AGO: Array = HISTORY_SLOTS_S.astype(np.float32)  # (T,) s, of each slot


def read_table(text: str) -> dict[str, list[str]]:
    """Return the columns of a table of words by the names in its first line; the second of a name is `name_2`."""
    names, *rows = (line.split() for line in text.strip().splitlines())
    out: dict[str, list[str]] = {}
    for number, name in enumerate(names):
        out[name if name not in out else f'{name}_2'] = [row[number] for row in rows]
    return out


class RandomArrays:
    """Random numbers from a seed; the same seed and calls give the same numbers."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.Generator(np.random.SFC64(seed))

    def to_state(self) -> dict[str, Any]:
        """Return the state of the generator as plain values."""
        state = dict(self.rng.bit_generator.state)
        return {**state, 'state': {name: value.tolist() for name, value in state['state'].items()}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state of `to_state`."""
        words = {name: np.array(value, np.uint64) for name, value in state['state'].items()}
        self.rng.bit_generator.state = {**state, 'state': words}

    def chance(self, count: int, share: float, *, axes: int = 0) -> Bools:
        """Return an array (count, 1, ...) with `axes` axes of length 1, true for a random share of examples."""
        return (self.rng.random(count) < share).reshape(count, *(1,) * axes)

    def choose(self, count: int, share: float, value: float, otherwise: float, *, axes: int = 0) -> Array:
        """Return `value` for a random share of examples and `otherwise` for the rest; shape as `chance`."""
        return np.where(self.chance(count, share, axes=axes), np.float32(value), np.float32(otherwise))

    def uniform(self, low: float, high: float, *shape: int) -> Array:
        """Return numbers that are uniformly distributed between `low` and `high`."""
        return np.float32(low) + np.float32(high - low) * self.rng.random(shape, dtype=np.float32)

    def log_uniform(self, limits: tuple[float, float], *shape: int) -> Array:
        """Return numbers whose logarithms are uniformly distributed between those of the limits."""
        return np.exp(self.uniform(*np.log(limits), *shape))

    def normal(self, *shape: int) -> Array:
        """Return numbers with the standard normal distribution."""
        return self.rng.standard_normal(shape, dtype=np.float32)


def normalise(vectors: Array) -> Array:
    """Return vectors (..., 3) with length 1; those of length 0 stay."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6))


def rotate_points(points: Array, rotation: Array) -> Array:
    """Rotate points (N, T, J, 3) by rotations (N, T, 3, 3) or (N, 1, 3, 3)."""
    if rotation.shape[1] == 1:
        count, slots, joints, _ = points.shape
        flat = points.reshape(count, slots * joints, 3) @ np.swapaxes(rotation[:, 0], -1, -2)
        return np.asarray(flat.reshape(count, slots, joints, 3))
    return np.asarray(points @ np.swapaxes(rotation, -1, -2))


def axis_rotations(axis: int, angle: Array | Array64) -> Array:
    """Return rotations (..., 3, 3) by angles (...) in rad about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*np.shape(angle), 3, 3), np.float32)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1
    out[..., a, a], out[..., a, b], out[..., b, a], out[..., b, b] = c, -s, s, c
    return out


def rotations_from_vectors(vector: Array) -> Array:
    """Return rotations (N, 3, 3) of rotation vectors (N, 3) in rad (Rodrigues)."""
    angle = np.maximum(np.linalg.norm(vector, axis=-1), 1e-6)[:, None, None]
    x, y, z = (vector / angle[:, 0]).T
    o = np.zeros_like(x)
    cross = np.stack([np.stack(r, -1) for r in ((o, -z, y), (z, o, -x), (-y, x, o))], -2)
    return np.asarray(np.eye(3, dtype=np.float32) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))


def add_bones(vectors: Array) -> Array:
    """Return the joints (..., J, 3) relative to the root, from the bone vectors that end in them."""
    out = vectors.copy()
    for parent, child in BODY26.outward_bones():
        out[..., child, :] += out[..., parent, :]
    return out


def find_trunks(points: Array) -> Array:
    """Return rotations (N, T, 3, 3) from the trunk's axes (forward, left, up) to those of joints (N, T, J, 3)."""
    left_hip, right_hip, left_shoulder, right_shoulder = (
        points[:, :, BODY26.index(j)] for j in ('lhip', 'rhip', 'lshoulder', 'rshoulder')
    )
    up = normalise(left_shoulder + right_shoulder - left_hip - right_hip)
    left = left_hip - right_hip
    left = normalise(left - (left * up).sum(axis=-1, keepdims=True) * up)
    return np.stack([np.cross(left, up), left, up], axis=-1)
