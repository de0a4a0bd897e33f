"""Derivatives of projected points by a frame's camera.

For a point q = s R p in the camera's frame, a rotation vector w on the camera's side and the logarithm l of the
scale,

    d q / d w = -[q]_x = ((0, z, -y), (-z, 0, x), (y, -x, 0)),    d q / d l = q.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def fill_camera_columns(out: Array, points: Array) -> None:
    """Write the derivatives of the x and y coordinates of points into an array.

    Args:
        out: (N, 2 or 3, J, 4), whose first two rows are written: derivatives by rotation vector and log scale.
        points: (N, J, 3) in the camera's frame, scaled.
    """
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    out[:, 0, :, 0], out[:, 1, :, 0] = 0.0, -z
    out[:, 0, :, 1], out[:, 1, :, 1] = z, 0.0
    out[:, 0, :, 2], out[:, 1, :, 2] = -y, x
    out[:, 0, :, 3], out[:, 1, :, 3] = x, y
