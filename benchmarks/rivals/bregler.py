# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recovering non-rigid 3D shape from image streams (Bregler, Hertzmann, Biermann, CVPR 2000).

    W = M B,   M_f = (c_f1 R_f ... c_fK R_f)                              rank 3K, by singular values
    the six entries of each block of M'_f as rows: (K, 6) = c_f r_f^T     rank 1, by singular values
    R_f = R'_f G,   B_k = G^-1 B'_k                                       G (3, 3) makes the R_f orthonormal

This is the method as printed. It takes for granted that the singular value decomposition orders the columns of M'
by basis shapes, which only a correction by a whole matrix G (3K, 3K) brings about (Xiao et al. 2004). The method
with that correction, see `factorisation`, is the second of the two forms here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import nearest_rotation
from rivals.factorisation import (
    factorise,
    find_coefficients,
    find_rotations,
    solve_gram_matrix,
    solve_shapes,
    stack_points,
    turn_to_camera,
)

Array = NDArray[np.float64]


def reconstruct_as_printed(points: Array, shapes: int) -> Array:
    """Reconstruct poses from image points as the paper prints it.

    Args:
        points: (F, J, 2) m, image points of a camera of scale 1.
        shapes: number K of basis shapes; one means a rigid body (Tomasi and Kanade 1992).

    Returns:
        (F, J, 3) m in the camera's optical frame, centred; or their mirror image in depth.
    """
    motion, basis = factorise(stack_points(points), shapes)
    frames = len(motion)
    by_shape = motion.reshape(frames, 2, shapes, 3).transpose(0, 2, 1, 3).reshape(frames, shapes, 6)
    u, s, vt = np.linalg.svd(by_shape, full_matrices=False)
    sign = np.where(
        u[:, :1, 0] < 0, -1.0, 1.0
    )  # the first shape, that of the largest singular values, is positive
    coefficients = sign * s[:, :1] * u[:, :, 0]
    rows = (sign * vt[:, 0]).reshape(frames, 2, 3)
    upgrade = solve_gram_matrix(rows, equal_scales=False)
    upgraded = rows @ upgrade
    scale = np.sqrt((upgraded**2).sum(axis=(1, 2)) / 2)
    metric_basis = np.linalg.pinv(upgrade) @ basis.reshape(shapes, 3, -1)
    found = np.einsum('fk,kaj->fja', coefficients * scale[:, None], metric_basis)
    return turn_to_camera(found, nearest_rotation(upgraded))


def reconstruct_with_full_upgrade(points: Array, shapes: int) -> Array:
    """Reconstruct poses from image points with the metric upgrade of all 3K columns; arguments as above."""
    measurements = stack_points(points)
    motion, _ = factorise(measurements, shapes)
    rotations = find_rotations(motion)
    coefficients = find_coefficients(motion, rotations, shapes)
    return turn_to_camera(solve_shapes(measurements, rotations, coefficients), rotations)
