# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of projected points by the rotation and the scale of a camera.

A point of the body is q = s R p = (x, y, z) in the camera's frame. A step changes R <- exp([w]x) R and the log
scale l. At w = 0,

                          (  0   z  -y )
    d q / d w = -[q]x  =  ( -z   0   x ),      d q / d l = q
                          (  y  -x   0 )

The first two rows are the derivatives of the image point under weak perspective; perspective needs the third.
"""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array

CAMERA_UNKNOWNS = 4  # of a frame: rotation vector (3) and logarithm of the scale, the last axis of all results


def camera_jacobian(points: Array, rows: int) -> Array:
    """Return the derivatives (..., rows, 4) of points q (..., 3): 2 rows for the image, 3 with the depth."""
    out = np.empty((*points.shape[:-1], rows, CAMERA_UNKNOWNS))
    fill_camera_jacobian(out, points)
    return out


def fill_camera_jacobian(out: Array, points: Array) -> None:
    """Write the derivatives of points q (..., 3) into an array or view (..., 2 or 3, 4)."""
    fill_rotation_jacobian(out[..., :3], points)
    out[..., 3] = points[..., : out.shape[-2]]


def fill_rotation_jacobian(out: Array, points: Array) -> None:
    """Write the derivatives of points q (..., 3) by the rotation vector alone into (..., 2 or 3, 3)."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 0.0, z, -y
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = -z, 0.0, x
    if out.shape[-2] > 2:
        out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = y, -x, 0.0
