# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Cut a rectangle out of an image at the size that a network takes.

The rectangle may reach beyond the image; what lies outside is black.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from mocap_ros.detectors.detector import Image

Array = NDArray[np.float64]

MIN_SIDE_PX = 1.0  # px; guards divisions by the size of a rectangle whose points coincide


class Box(NamedTuple):
    """A rectangle in an image, in px of the image, whose first pixel covers 0 to 1."""

    left: float
    top: float
    width: float
    height: float

    def place(self, points: Array) -> Array:
        """Return points (..., 2) in shares of the rectangle as points in px of the image."""
        return np.array([self.left, self.top]) + points * [self.width, self.height]

    def widen(self, factor: float, aspect: float) -> Box:
        """Return the smallest rectangle of this ratio of width to height that holds this one, times a factor."""
        width, height = max(self.width, self.height * aspect), max(self.height, self.width / aspect)
        x, y = self.left + self.width / 2, self.top + self.height / 2
        width, height = max(width * factor, MIN_SIDE_PX), max(height * factor, MIN_SIDE_PX)
        return Box(x - width / 2, y - height / 2, width, height)


def bound_image(image: Image) -> Box:
    """Return the rectangle of a whole image."""
    return Box(0.0, 0.0, float(image.shape[1]), float(image.shape[0]))


def bound_points(points: Array) -> Box:
    """Return the rectangle around points (N, 2) in px."""
    low, high = points.min(axis=0), points.max(axis=0)
    return Box(*low.tolist(), *(high - low).tolist())


def cut_out(image: Image, box: Box, size: tuple[int, int]) -> Image:
    """Return a rectangle of an image, resized.

    Args:
        image: (H, W, 3) red, green, blue.
        box: the rectangle in px.
        size: (width, height) in px of the result.

    Returns:
        (height, width, 3); black where the rectangle lies outside of the image.
    """
    scale = size[0] / box.width, size[1] / box.height  # px of the result per px of the image
    sides = image.shape[1], image.shape[0]
    # the part of the result that shows the image, in whole px
    low = [math.ceil(max(-start, 0.0) * s - 1e-9) for start, s in zip((box.left, box.top), scale, strict=True)]
    high = [
        min(side, math.floor((end - start) * s + 1e-9))
        for side, end, start, s in zip(size, sides, (box.left, box.top), scale, strict=True)
    ]
    out = np.zeros((size[1], size[0], 3), np.uint8)
    if low[0] < high[0] and low[1] < high[1]:
        source = (
            max(box.left + low[0] / scale[0], 0.0),
            max(box.top + low[1] / scale[1], 0.0),
            min(box.left + high[0] / scale[0], sides[0]),
            min(box.top + high[1] / scale[1], sides[1]),
        )
        part = Pillow.fromarray(image).resize(
            (high[0] - low[0], high[1] - low[1]), Pillow.Resampling.BILINEAR, box=source, reducing_gap=2.0
        )
        out[low[1] : high[1], low[0] : high[0]] = np.asarray(part)
    return out
