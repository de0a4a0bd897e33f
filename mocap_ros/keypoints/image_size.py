# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The size of the image in which keypoints were seen."""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array

ImageSize = tuple[int, int]  # (width, height) in px, (0, 0) where unknown

UNKNOWN_SIZE: ImageSize = (0, 0)  # px
# (width, height) in px of common videos, smallest first; the smallest that holds the keypoints is assumed.
COMMON_IMAGE_SIZES = ((640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160), (7680, 4320))
IMAGE_SIZE_PERCENTILE = 99  # percent of the keypoints that the assumed image holds; the others may be outliers


def resolve_image_size(
    *,
    stated: ImageSize | None = None,
    camera: ImageSize | None = None,
    configured: ImageSize | None = None,
    keypoints: Array | None = None,
) -> ImageSize:
    """Return the (width, height) of the image in px: the first in this order that is known, or `UNKNOWN_SIZE`.

    A side of 0 is unknown. Readers of whole files pass keypoints (..., 3), for the smallest of
    `COMMON_IMAGE_SIZES` that holds 99 % of the seen ones; in a live stream, later ones could change the size.
    """
    for size in (stated, camera, configured):
        if size is not None and all(size):
            return size
    return UNKNOWN_SIZE if keypoints is None else _assume_common_size(keypoints)


def _assume_common_size(keypoints: Array) -> ImageSize:
    seen = keypoints[keypoints[..., 2] > 0][:, :2]
    extent = np.percentile(seen, IMAGE_SIZE_PERCENTILE, axis=0) if len(seen) else np.zeros(2)
    return next((size for size in COMMON_IMAGE_SIZES if (extent <= size).all()), COMMON_IMAGE_SIZES[-1])
