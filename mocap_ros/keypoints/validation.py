"""What every 2D keypoint must fulfil, wherever it comes from: message or file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_SCORE, GREATEST_SCORE = -1e-3, 1.25
NORMALISED_RANGE = -0.5, 1.5
SMALLEST_IMAGE = 16
FARTHEST_POINT = 1e6
JUDGED_POINTS = 4


@dataclass(frozen=True)
class Fault:
    """The first keypoint that cannot be used.

    Attributes:
        field: `x`, `y` or `score`.
        index: of the keypoint in the scores.
        what: what is wrong with it.
    """

    field: str
    index: tuple[int, ...]
    what: str


def first_fault(points: Array, score: Array) -> Fault | None:
    """The first coordinate beyond `FARTHEST_POINT`, or score outside [`LEAST_SCORE`, `GREATEST_SCORE`].

    Some detectors' scores exceed 1 a little; they are clipped.

    Args:
        points: (..., J, 2) px; NaN is no fault.
        score: (..., J); NaN is no fault.
    """
    outside = (score < LEAST_SCORE) | (score > GREATEST_SCORE)
    for field, wrong, values in (
        ('x', np.abs(points[..., 0]) > FARTHEST_POINT, points[..., 0]),
        ('y', np.abs(points[..., 1]) > FARTHEST_POINT, points[..., 1]),
        ('score', outside, score),
    ):
        if wrong.any():
            index = tuple(int(i) for i in np.argwhere(wrong)[0])
            expected = 'a score in [0, 1]' if field == 'score' else 'a finite number of px'
            return Fault(field, index, f'{values[index]:g}, expected {expected}')
    return None


def tidied(points: Array, score: Array) -> tuple[Array, Array]:
    """The same keypoints with NaN points and score 0 wherever one of them says "not seen".

    Args:
        points: (..., J, 2) px.
        score: (..., J) in [0, 1], a little more, or NaN.
    """
    seen = (score > 0) & np.isfinite(points).all(axis=-1)
    return np.where(seen[..., None], points, np.nan), np.where(seen, np.minimum(score, 1.0), 0.0)


def looks_normalised(points: Array, score: Array, image_width: int) -> bool:
    """Whether coordinates are plainly shares of the image, where px are expected.

    Args:
        points: (..., J, 2) as `tidied` returns them.
        score: (..., J) likewise.
        image_width: px, 0 where unknown.
    """
    seen = points[score > 0]
    low, high = NORMALISED_RANGE
    tiny = 0 < image_width <= SMALLEST_IMAGE
    return not tiny and len(seen) >= JUDGED_POINTS and bool(((seen >= low) & (seen <= high)).all())
