# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of 2D keypoints that hold for every source: messages and files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNSEEN_POINTS_PX = (0.0, -1.0)  # px; x = y = one of these is what detectors write for a point that they do not see
NORMALISED_RANGE = -0.5, 1.5  # shares of the image; a normalised point may lie outside the image by half of it
MAX_METRES = 10.0  # m; joints of a person in 3D are within it, of whom some coordinates are negative
TINY_IMAGE_WIDTH = 16  # px; in an image up to this wide, real px look like normalised coordinates
MAX_COORDINATE_PX = 1e6  # px; far outside any image
MAX_SHARE_OUTSIDE = 0.5  # share of the points; with more of them outside the image, its size is probably wrong
MIN_SHARE_HELD = 0.95  # share of the points that an image must hold to be the right one; a few may be outliers
MIN_JUDGED_POINTS = 4  # points; fewer may lie in the corner of the image by chance


@dataclass(frozen=True)
class Fault:
    """The first keypoint value that cannot be used."""

    field: str  # `x`, `y` or `score`
    index: tuple[int, ...]  # index of the keypoint in the array of scores
    what: str  # the value, and what was expected instead


def find_first_fault(points: Array, score: Array) -> Fault | None:
    """Find the first coordinate beyond `MAX_COORDINATE_PX` or infinite score; NaN is no fault."""
    for field, is_faulty, values, expected in (
        ('x', np.abs(points[..., 0]) > MAX_COORDINATE_PX, points[..., 0], 'a finite number of px'),
        ('y', np.abs(points[..., 1]) > MAX_COORDINATE_PX, points[..., 1], 'a finite number of px'),
        ('score', np.isinf(score), score, 'a finite score'),
    ):
        if is_faulty.any():
            index = tuple(int(i) for i in np.argwhere(is_faulty)[0])
            return Fault(field, index, f'{values[index]:g}, expected {expected}')
    return None


def mark_unseen(points: Array, score: Array) -> tuple[Array, Array]:
    """Mark joints that were not seen, by NaN in points (..., J, 2) px and 0 in scores (..., J).

    So are points of NaN, (0, 0) or (-1, -1) and scores of 0, less or NaN. The scores of a person are divided by
    the largest where that exceeds 1.
    """
    seen = find_seen(points, score)
    score = np.where(seen, score, 0.0)
    largest = score.max(axis=-1, keepdims=True, initial=1.0)
    return np.where(seen[..., None], points, np.nan), score / largest


def find_seen(points: NDArray[np.floating[Any]], score: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return which keypoints (..., J) a detector has seen; arguments as of `mark_unseen`."""
    x, y = points[..., 0], points[..., 1]
    is_placeholder = (x == y) & ((x == UNSEEN_POINTS_PX[0]) | (x == UNSEEN_POINTS_PX[1]))
    return (score > 0) & np.isfinite(x) & np.isfinite(y) & ~is_placeholder


def describe_other_unit(points: Array, score: Array, image_width: int) -> str:
    """Describe in a clause that coordinates are plainly no px; return an empty string if they may be px.

    Points and scores are those of `mark_unseen`; a width of 0 px is unknown.
    """
    seen = points[score > 0]
    if len(seen) < MIN_JUDGED_POINTS or 0 < image_width <= TINY_IMAGE_WIDTH or (np.abs(seen) > MAX_METRES).any():
        return ''
    low, high = NORMALISED_RANGE
    if ((seen >= low) & (seen <= high)).all():
        return 'looks normalised; px expected: multiply x by the width of the image and y by its height'
    if (seen < low).any():
        return 'looks like 3D joints in m; 2D keypoints in px expected'
    return ''


def measure_share_outside(points: Array, score: Array, image_size: tuple[int, int]) -> float:
    """Return the share of the seen keypoints that lie outside the image (width, height); 0 if too few are seen."""
    seen = points[score > 0]
    return 1 - _measure_share_inside(seen, *image_size) if len(seen) >= MIN_JUDGED_POINTS else 0.0


def describe_points_outside(points: Array, score: Array, image_size: tuple[int, int]) -> str:
    """Describe in a clause that most keypoints lie outside the image, or return an empty string."""
    outside = measure_share_outside(points, score, image_size)
    if outside <= MAX_SHARE_OUTSIDE:
        return ''
    return f'{outside:.0%} of the seen keypoints lie outside {image_size[0]} x {image_size[1]} px'


def describe_transposed_size(points: Array, score: Array, image_size: tuple[int, int]) -> str:
    """Describe in a clause that width and height seem exchanged, or return an empty string."""
    fault = describe_points_outside(points, score, image_size)
    height, width = image_size
    if not fault or _measure_share_inside(points[score > 0], width, height) < MIN_SHARE_HELD:
        return ''
    return f'{fault}, but inside {width} x {height} px: width and height look transposed'


def _measure_share_inside(points: Array, width: int, height: int) -> float:
    inside = ((points >= 0) & (points <= [width, height])).all(axis=-1)
    return float(inside.mean()) if len(points) else 1.0
