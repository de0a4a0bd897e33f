# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations as vectors, matrices and quaternions, and the rotation that best aligns two sets of points."""

from __future__ import annotations

import math

import numpy as np

from mocap_ros.arrays import Array

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # axes of the factors in a cross product
MIN_ANGLE = 1e-30  # rad; guards the division by an angle of zero
MIN_SINE = 1e-12  # 1; guards the division by the sine of the rotation angle near the identity


def nearest_rotation(affine: Array) -> Array:
    """A = U S V^T -> R[:2] = U V^T (TPAMI 2016, section 3.2), R (..., 3, 3) nearest to A (..., 2, 3)."""
    u, _, vt = np.linalg.svd(affine, full_matrices=False)
    rows = u @ vt
    third = np.cross(rows[..., 0, :], rows[..., 1, :])
    return np.concatenate([rows, third[..., None, :]], axis=-2)


def rotation_from_vector(vector: Array) -> Array:
    """R = I + sin(a) / a K + (1 - cos(a)) / a^2 K^2 (Rodrigues) of vectors v (..., 3), K p = v x p, a = |v|."""
    angle = np.maximum(np.sqrt((vector * vector).sum(axis=-1)), MIN_ANGLE)[..., None, None]
    k, half = cross_matrix(vector), angle / 2
    return np.eye(3) + np.sin(angle) / angle * k + 0.5 * (np.sin(half) / half) ** 2 * (k @ k)


def quaternion_from_rotation(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a rotation matrix (3, 3), by Shepperd's method."""
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


def multiply_quaternions(first: Array, second: Array) -> Array:
    """Return the products (..., 4) of quaternions x, y, z, w (..., 4): the rotation `second`, then `first`."""
    v, w, a, b = first[..., :3], first[..., 3:], second[..., :3], second[..., 3:]
    cross = v[..., _NEXT] * a[..., _LAST] - v[..., _LAST] * a[..., _NEXT]  # five times as fast as numpy.cross
    vector = w * a + b * v + cross
    return np.concatenate([vector, w * b - (v * a).sum(axis=-1, keepdims=True)], axis=-1)


def cross_matrix(v: Array) -> Array:
    """Return the cross-product matrices (..., 3, 3) of vectors (..., 3): `cross_matrix(v) @ x == cross(v, x)`."""
    out = np.zeros((*v.shape, 3))
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        out[..., row, column] = v[..., axis]
        out[..., column, row] = -v[..., axis]
    return out


def vector_from_rotation(rotation: Array) -> Array:
    """Return the rotation vectors (..., 3) in rad of rotation matrices (..., 3, 3), for angles below pi."""
    twice = np.swapaxes(rotation, -1, -2) - rotation
    axis = -0.5 * np.stack([twice[..., 2, 1], twice[..., 0, 2], twice[..., 1, 0]], axis=-1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, (np.einsum('...ii->...', rotation) - 1) / 2)
    return np.asarray(axis * (np.maximum(angle, MIN_SINE) / np.maximum(sine, MIN_SINE))[..., None])


def centre_poses(poses: Array) -> Array:
    """Move poses (..., J, 3) so that the mean of each pose's joints is the origin."""
    return poses - poses.mean(axis=-2, keepdims=True)


def fit_rotation(poses: Array, target: Array) -> Array:
    """Return the rotations (..., 3, 3) that minimise sum_j |R p_j - q_j|^2 (orthogonal Procrustes problem)."""
    u, _, vt = np.linalg.svd(np.swapaxes(target, -1, -2) @ poses)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * sign[..., None, :]) @ vt)


def fit_heading_rotation(poses: Array, target: Array) -> Array:
    """Minimise sum_j |R_z(a) p_j - q_j|^2 over headings a: tan(a) = sum_j (p_j x q_j)_z / sum_j (p_j . q_j)_xy.

    Return the rotations (..., 3, 3) about z that bring `poses` closest to `target`, both (..., J, 3).
    """
    cross = poses[..., 0] * target[..., 1] - poses[..., 1] * target[..., 0]
    dot = poses[..., 0] * target[..., 0] + poses[..., 1] * target[..., 1]
    angle = np.arctan2(cross.sum(-1), dot.sum(-1))
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[c, -s, o], [s, c, o], [o, o, o + 1]]
    return np.stack([np.stack(r, -1) for r in rows], -2)
