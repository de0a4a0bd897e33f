# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rectangles of an image at which networks look, and what is in them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from PIL import Image as Pillow

from mocap_ros.arrays import Array
from mocap_ros.detectors.detector import Image

MIN_SIDE_PX = 1.0  # px; guards divisions by the size of a rectangle whose points coincide


class Box(NamedTuple):
    """A rectangle in an image, in px of the image, whose first pixel covers 0 to 1."""

    left: float
    top: float
    width: float
    height: float

    @staticmethod
    def around_image(image: Image) -> Box:
        """Return the rectangle of a whole image."""
        return Box(0.0, 0.0, float(image.shape[1]), float(image.shape[0]))

    @staticmethod
    def around_points(points: Array) -> Box:
        """Return the rectangle around points (N, 2) in px."""
        low, high = points.min(axis=0), points.max(axis=0)
        return Box(*low.tolist(), *(high - low).tolist())

    def place(self, points: Array) -> Array:
        """Return points (..., 2) in shares of the rectangle as points in px of the image."""
        return np.array([self.left, self.top]) + points * [self.width, self.height]

    def widen(self, factor: float, aspect: float) -> Box:
        """Return the smallest rectangle of this ratio of width to height that holds this one, times a factor."""
        width, height = max(self.width, self.height * aspect), max(self.height, self.width / aspect)
        x, y = self.left + self.width / 2, self.top + self.height / 2
        width, height = max(width * factor, MIN_SIDE_PX), max(height * factor, MIN_SIDE_PX)
        return Box(x - width / 2, y - height / 2, width, height)


def cut_out(image: Image, box: Box, size: tuple[int, int], ground: int = 0) -> Image:
    """Return a rectangle of an image, resized to (width, height) in px; `ground` outside of the image."""
    left, top = (max(math.floor(start), 0) for start in box[:2])
    right, bottom = (max(math.ceil(end), 0) for end in (box.left + box.width, box.top + box.height))
    image = image[top:bottom, left:right]  # Pillow copies all that it gets
    box = box._replace(left=box.left - left, top=box.top - top)
    scale = size[0] / box.width, size[1] / box.height  # px of the result per px of the image
    sides = image.shape[1], image.shape[0]
    # the part of the result that shows the image, in whole px
    low = [math.ceil(max(-start, 0.0) * s - 1e-9) for start, s in zip(box[:2], scale, strict=True)]
    high = [
        min(side, math.floor((end - start) * s + 1e-9))
        for side, end, start, s in zip(size, sides, box[:2], scale, strict=True)
    ]
    out = np.full((size[1], size[0], 3), ground, np.uint8)
    if low[0] < high[0] and low[1] < high[1]:
        source = (
            max(box.left + low[0] / scale[0], 0.0),
            max(box.top + low[1] / scale[1], 0.0),
            min(box.left + high[0] / scale[0], sides[0]),
            min(box.top + high[1] / scale[1], sides[1]),
        )
        part = Pillow.fromarray(image).resize(
            (high[0] - low[0], high[1] - low[1]), Pillow.Resampling.BILINEAR, box=source, reducing_gap=1.0
        )
        out[low[1] : high[1], low[0] : high[0]] = np.asarray(part)
    return out
