# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations as vectors, matrices and quaternions, and the rotation that best aligns two sets of points."""

from __future__ import annotations

import math

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, kernel

Array = NDArray[np.float64]

MAX_EIGENVALUE_STEPS = 30  # Newton steps; five are enough but near a double root, where a step halves the error
EIGENVALUE_TOLERANCE = 1e-15  # relative; rounding
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # axes of the factors in a cross product
MIN_SINE = 1e-12  # 1; guards the division by the sine of the rotation angle near the identity


def nearest_rotation(affine: Array) -> Array:
    """A = U S V^T -> R[:2] = U V^T (TPAMI 2016, section 3.2: singular values set to one).

    Return the rotations (..., 3, 3) whose first two rows are closest to the affine matrices (..., 2, 3).
    """
    u, _, vt = np.linalg.svd(affine, full_matrices=False)
    rows = u @ vt
    third = np.cross(rows[..., 0, :], rows[..., 1, :])
    return np.concatenate([rows, third[..., None, :]], axis=-2)


def rotation_from_vector(vector: Array) -> Array:
    """R = I + sin(a) / a K + (1 - cos(a)) / a^2 K^2 (Rodrigues), where K p = v x p and a = |v|.

    Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3) in rad.
    """
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = cross_matrix(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)


@kernel(void(FLOATS_1D, FLOATS_2D))
def write_rotation_from_vector(vector: Array, out: Array) -> None:
    """Write the rotation matrix (3, 3) of a rotation vector (3,) in rad; the formula of `rotation_from_vector`."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = math.sqrt(x * x + y * y + z * z)
    half_sinc = math.sin(angle / 2) / (angle / 2) if angle > 0 else 1.0
    a = math.sin(angle) / angle if angle > 0 else 1.0
    b = 0.5 * half_sinc * half_sinc
    out[0, 0], out[0, 1], out[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)


@kernel(FLOAT(FLOAT, FLOAT))
def _largest_root(determinant: float, constant: float) -> float:
    """Return the largest root of x^4 - 2 x^2 - 8 d x + c by Newton's method, going down from sqrt(3)."""
    x = math.sqrt(3.0)  # no smaller than the sum of three singular values whose squares add up to 1
    for _ in range(MAX_EIGENVALUE_STEPS):
        value = ((x * x - 2) * x - 8 * determinant) * x + constant
        slope = (4 * x * x - 4) * x - 8 * determinant
        if not slope > 0:
            break
        step = value / slope
        x -= step
        if abs(step) < EIGENVALUE_TOLERANCE * x:
            break
    return x


@kernel(FLOATS_1D(FLOATS_2D))
def _null_vector(matrix: Array) -> Array:
    """Return the longest column (4,) of the adjugate of a matrix (4, 4) of rank 3: a vector that it maps to 0."""
    best, longest, column = -1.0, np.zeros(4), np.empty(4)
    minor = np.empty((3, 3))
    for i in range(4):
        for j in range(4):
            for a in range(3):
                for b in range(3):
                    minor[a, b] = matrix[a if a < i else a + 1, b if b < j else b + 1]
            cofactor = (
                minor[0, 0] * (minor[1, 1] * minor[2, 2] - minor[1, 2] * minor[2, 1])
                - minor[0, 1] * (minor[1, 0] * minor[2, 2] - minor[1, 2] * minor[2, 0])
                + minor[0, 2] * (minor[1, 0] * minor[2, 1] - minor[1, 1] * minor[2, 0])
            )
            column[j] = cofactor if (i + j) % 2 == 0 else -cofactor
        squared = (column * column).sum()
        if squared > best:
            best = squared
            longest[:] = column
    return longest


@kernel(void(FLOATS_2D, FLOATS_2D))
def write_best_rotation(products: Array, out: Array) -> None:
    """Write the rotation R (3, 3) that maximises tr(R^T M), M = sum_j q_j p_j^T (3, 3): the closest R p_j to q_j.

    tr(R^T M) is a quadratic form of the quaternion of R, whose matrix K (4, 4) has trace 0. Its largest eigenvalue
    is found by Newton's method on the characteristic polynomial from an upper bound down; its eigenvector is a
    column of the adjugate of K - lambda I (Horn 1987; Theobald 2005). Where M has rank 0 or 1 the rotation is one
    of many.
    """
    m = products
    size = (m * m).sum()
    if not size > 0:
        out[:] = np.eye(3)
        return
    scale = 1 / math.sqrt(size)
    xx, xy, xz = scale * m[0, 0], scale * m[0, 1], scale * m[0, 2]
    yx, yy, yz = scale * m[1, 0], scale * m[1, 1], scale * m[1, 2]
    zx, zy, zz = scale * m[2, 0], scale * m[2, 1], scale * m[2, 2]
    k = np.empty((4, 4))
    k[0, 0], k[0, 1], k[0, 2], k[0, 3] = xx + yy + zz, zy - yz, xz - zx, yx - xy
    k[1, 1], k[1, 2], k[1, 3] = xx - yy - zz, yx + xy, xz + zx
    k[2, 2], k[2, 3], k[3, 3] = yy - xx - zz, zy + yz, zz - xx - yy
    for i in range(4):
        for j in range(i):
            k[i, j] = k[j, i]
    # characteristic polynomial x^4 - 2 x^2 - 8 det(M) x + c of the normalised matrix, c = det(K)
    determinant = xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx)
    constant = np.linalg.det(k)
    x = _largest_root(determinant, constant)
    for i in range(4):
        k[i, i] -= x
    quaternion = _null_vector(k)
    norm = math.sqrt((quaternion * quaternion).sum())
    w, x, y, z = (
        (quaternion[0] / norm, quaternion[1] / norm, quaternion[2] / norm, quaternion[3] / norm)
        if norm > 0
        else (1.0, 0.0, 0.0, 0.0)
    )
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


def quaternion_from_rotation(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a rotation matrix (3, 3).

    The division is by the largest of the four components (Shepperd's method), so no rotation loses precision.
    """
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
    """Return the rotation vectors (..., 3) in rad of rotation matrices (..., 3, 3).

    This is the inverse of `rotation_from_vector` for angles below pi. The result is wrong for an angle of pi.
    """
    twice = np.swapaxes(rotation, -1, -2) - rotation
    axis = -0.5 * np.stack([twice[..., 2, 1], twice[..., 0, 2], twice[..., 1, 0]], axis=-1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, (np.einsum('...ii->...', rotation) - 1) / 2)
    return np.asarray(axis * (np.maximum(angle, MIN_SINE) / np.maximum(sine, MIN_SINE))[..., None])


def centre_poses(poses: Array) -> Array:
    """Move poses (..., J, 3) so that the mean of each pose's joints is the origin."""
    return poses - poses.mean(axis=-2, keepdims=True)


def fit_rotation(poses: Array, target: Array) -> Array:
    """Minimise sum_j |R p_j - q_j|^2 over rotations R (orthogonal Procrustes problem).

    Return the rotations (..., 3, 3) with `poses @ R^T` closest to `target`, both (..., J, 3).
    """
    u, _, vt = np.linalg.svd(np.swapaxes(target, -1, -2) @ poses)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * sign[..., None, :]) @ vt)


def fit_heading_rotation(poses: Array, target: Array) -> Array:
    """Minimise sum_j |R_z(a) p_j - q_j|^2 over headings a: tan(a) = sum_j (p_j x q_j)_z / sum_j (p_j . q_j)_xy.

    Return the rotations (..., 3, 3) about the vertical (z) that bring `poses` closest to `target`, both of shape
    (..., J, 3).
    """
    cross = poses[..., 0] * target[..., 1] - poses[..., 1] * target[..., 0]
    dot = poses[..., 0] * target[..., 0] + poses[..., 1] * target[..., 1]
    angle = np.arctan2(cross.sum(-1), dot.sum(-1))
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[c, -s, o], [s, c, o], [o, o, o + 1]]
    return np.stack([np.stack(r, -1) for r in rows], -2)
