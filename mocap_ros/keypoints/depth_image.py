# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Depths of keypoints in a depth image that is registered to the image of the keypoints.

The surface at a keypoint is what is seen in a small disc about it, of a radius that is a share of the person's
size, by the median distance of the points from their median. Where the disc reaches beyond a limb, the background
is behind it, so a low quantile of the depths in it is the limb's; and few pixels that are too near, as between two
surfaces, do not change it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array

RADIUS_SHARE = 0.045  # 1; of that distance: 2 cm of a person who stands
RADIUS_RANGE_PX = 1.5, 40.0  # px; fewer than nine pixels are all noise, and more than thousands are too slow
QUANTILE = 0.25  # 1; half of the disc may be background
MIN_SHARE_KNOWN = 0.25  # 1; share of the pixels whose depth is known
RANGE_M = 0.2, 20.0  # m; nearer and farther away depth cameras measure nothing


def sample_depth(image: NDArray[np.generic], unit_m: float, points: Array) -> Array:
    """Return the depths (J,) m of the surfaces at points (J, 2) px; NaN where unknown.

    `image` (H, W) has depths in the unit `unit_m` m, 0 or NaN where unknown; a point is NaN where it is not seen.
    """
    seen = np.flatnonzero(np.isfinite(points).all(axis=1))
    out = np.full(len(points), np.nan)
    if not len(seen):
        return out
    offsets = points[seen] - np.median(points[seen], axis=0)
    spread = float(np.median(np.linalg.norm(offsets, axis=1)))
    radius = min(max(RADIUS_SHARE * spread, RADIUS_RANGE_PX[0]), RADIUS_RANGE_PX[1])
    reach = np.arange(-int(radius), int(radius) + 1)
    dx, dy = (steps.ravel() for steps in np.meshgrid(reach, reach))
    is_near = dx**2 + dy**2 <= radius**2
    centres = np.rint(points[seen]).astype(int)
    x, y = centres[:, :1] + dx[is_near], centres[:, 1:] + dy[is_near]
    height, width = image.shape
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    depth = unit_m * image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(float)
    is_known = is_inside & (depth > RANGE_M[0]) & (depth < RANGE_M[1])
    count = is_known.sum(axis=1)
    ranked = np.sort(np.where(is_known, depth, np.inf), axis=1)
    low = ranked[np.arange(len(seen)), (QUANTILE * count).astype(int)]
    out[seen] = np.where(count >= MIN_SHARE_KNOWN * depth.shape[1], low, np.nan)
    return out
