"""Rotations: vectors, matrices, quaternions, and the rotation that brings one set of points closest to another."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def nearest_rotation(affine: Array) -> Array:
    """(..., 2, 3) -> (..., 3, 3) rotations whose first rows are nearest: singular values set to one."""
    u, _, vt = np.linalg.svd(affine, full_matrices=False)
    rows = u @ vt
    third = np.cross(rows[..., 0, :], rows[..., 1, :])
    return np.concatenate([rows, third[..., None, :]], axis=-2)


def small_rotation(vector: Array) -> Array:
    """(..., 3) rotation vectors in rad -> (..., 3, 3) (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = cross_matrix(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a rotation (3, 3), w at least 0; from the largest of the four (Shepperd)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    trace = a + e + i
    if trace >= max(a, e, i):
        x, y, z, w = h - f, c - g, d - b, 1 + trace
    elif a >= max(e, i):
        x, y, z, w = 1 + 2 * a - trace, b + d, c + g, h - f
    elif e >= i:
        x, y, z, w = b + d, 1 + 2 * e - trace, f + h, c - g
    else:
        x, y, z, w = c + g, f + h, 1 + 2 * i - trace, d - b
    factor = math.copysign(1 / math.sqrt(x * x + y * y + z * z + w * w), w)
    return x * factor, y * factor, z * factor, w * factor


def cross_matrix(v: Array) -> Array:
    """(..., 3) -> (..., 3, 3) with `cross_matrix(v) @ x == cross(v, x)`."""
    out = np.zeros((*v.shape, 3))
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        out[..., row, column] = v[..., axis]
        out[..., column, row] = -v[..., axis]
    return out


def rotation_vector(rotation: Array) -> Array:
    """(..., 3, 3) rotations by less than half a turn -> (..., 3) rad; the inverse of `small_rotation`."""
    twice = np.swapaxes(rotation, -1, -2) - rotation
    axis = -0.5 * np.stack([twice[..., 2, 1], twice[..., 0, 2], twice[..., 1, 0]], axis=-1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, (np.einsum('...ii->...', rotation) - 1) / 2)
    return np.asarray(axis * (np.maximum(angle, 1e-12) / np.maximum(sine, 1e-12))[..., None])


def centred(poses: Array) -> Array:
    """Poses (..., J, 3) moved so that the mean of the joints is the origin."""
    return poses - poses.mean(axis=-2, keepdims=True)


def rotation_to(poses: Array, target: Array) -> Array:
    """(..., 3, 3) rotations R with `poses @ R^T` closest to `target` (orthogonal Procrustes)."""
    u, _, vt = np.linalg.svd(np.swapaxes(target, -1, -2) @ poses)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * sign[..., None, :]) @ vt)


def heading_to(poses: Array, target: Array) -> Array:
    """(..., 3, 3) rotations about the vertical (z) that bring `poses` closest to `target`."""
    cross = poses[..., 0] * target[..., 1] - poses[..., 1] * target[..., 0]
    dot = poses[..., 0] * target[..., 0] + poses[..., 1] * target[..., 1]
    angle = np.arctan2(cross.sum(-1), dot.sum(-1))
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[c, -s, o], [s, c, o], [o, o, o + 1]]
    return np.stack([np.stack(r, -1) for r in rows], -2)
