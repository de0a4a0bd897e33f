# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of 2D keypoints and of their times that hold for every source: messages and files."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.errors import InputError
from mocap_ros.findings import SOUND, Fault, Finding, Grade

NORMALISED_RANGE = -0.5, 1.5  # shares of the image; a normalised point may lie outside the image by half of it
MAX_METRES = 10.0  # m; joints of a person in 3D are within it, of whom some coordinates are negative
TINY_IMAGE_WIDTH = 16  # px; in an image up to this wide, real px look like normalised coordinates
MAX_COORDINATE_PX = 1e6  # px; far outside any image
BORDER_PX = 0.5  # px; whole pixels and float32 are off by less
MAX_SHARE_OUTSIDE = 0.5  # share of the points; with more of them outside the image, its size is probably wrong
MIN_SHARE_HELD = 0.95  # share of the points that an image must hold to be the right one; a few may be outliers
MIDDLE, SPREAD = np.array([0.5, 0.47]), np.array([0.17, 0.12])  # 1; of positions of people, in width and height
MIN_EVIDENCE = 2.5  # 1, log likelihood; people who stay in a corner for a whole recording are rare
BEYOND_EVIDENCE = 1.5  # 1, of points beyond the image, which detectors give of people whom it cuts off
MIN_SHARE_BEYOND = 0.02  # 1; share of points beyond the image that counts
MIN_JUDGED_POINTS = 4  # points; fewer may lie in the corner of the image by chance
MIN_STEP_S = 1 / 2000  # s, from image to image; no camera that sees whole people is faster
MAX_STEP_S = 1.0  # s; a person moves too much in it to be followed from image to image
MIN_JUDGED_FRAMES = 30  # frames; fewer at long intervals may be single pictures instead of a video
UNITS = 'seconds', 'milliseconds', 'microseconds', 'nanoseconds'  # each a thousandth of the one before


# Other sizes of images, by the fault if they are the right ones: factors of the side itself and of the other one
OTHER_SIZES = {
    Fault.SIZE_TRANSPOSED: (0.0, 1.0),
    Fault.SIZE_SMALLER: (0.5, 0.0),
    Fault.SIZE_LARGER: (1.5, 0.0),
}


@dataclass(frozen=True)
class UnusableValue:
    """The first keypoint value that cannot be used."""

    field: str  # `x`, `y` or `score`
    index: tuple[int, ...]  # index of the keypoint in the array of scores
    what: str  # the value, and what was expected instead


def _find_unusable_value(points: Array, score: Array) -> UnusableValue | None:
    for field, is_faulty, values, expected in (
        ('x', np.abs(points[..., 0]) > MAX_COORDINATE_PX, points[..., 0], 'a finite number of px'),
        ('y', np.abs(points[..., 1]) > MAX_COORDINATE_PX, points[..., 1], 'a finite number of px'),
        ('score', np.isinf(score), score, 'a finite score'),
    ):
        if is_faulty.any():
            index = tuple(int(i) for i in np.argwhere(is_faulty)[0])
            return UnusableValue(field, index, f'{values[index]:g}, expected {expected}')
    return None


def mark_unseen(points: Array, score: Array) -> tuple[Array, Array, UnusableValue | None]:
    """Mark joints that were not seen, by NaN in points (..., J, 2) px and 0 in scores (..., J).

    So are points of NaN, (0, 0) or (-1, -1) and scores of 0, less or NaN. Scores of which some are below -1 and
    some above 1 are logits, and become 1 / (1 + exp(-score)). The scores of a person are divided by the largest
    where that exceeds 1. Returns points, scores, and the first coordinate beyond `MAX_COORDINATE_PX` or infinite
    score, if there is one; NaN is no fault.
    """
    shape = math.prod(score.shape[:-1]), score.shape[-1]
    people = np.asarray(points, float).reshape(*shape, 2), np.asarray(score, float).reshape(shape)
    seen_points, seen_score, is_faulty = engine.mark_unseen(*people, MAX_COORDINATE_PX)
    fault = _find_unusable_value(points, score) if is_faulty else None
    return seen_points.reshape(points.shape), seen_score.reshape(score.shape), fault


def mark_unknown_depth(depth: Array) -> Array:
    """Return depths in m of which those that are none, such as 0 and infinity, are NaN."""
    return np.where((depth > 0) & np.isfinite(depth), depth, np.nan)


def find_border_points(points: Array, image_size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which points (..., 2) px lie on the border of an image; a size of (0, 0) px is unknown.

    There detectors put what they expect beyond it: at 0, at width and height, or 1 px before these.
    """
    if not all(image_size):
        return np.zeros(points.shape[:-1], bool)
    is_first, far = np.abs(points) <= BORDER_PX, points - np.array(image_size) + 0.5
    return np.asarray((is_first | (np.abs(far) <= 0.5 + BORDER_PX)).any(axis=-1))


def describe_other_unit(points: Array, score: Array, image_width: int) -> str:
    """Describe in a clause that coordinates are plainly no px; return an empty string if they may be px.

    Points and scores are those of `mark_unseen`; a width of 0 px is unknown.
    """
    if np.count_nonzero(np.abs(points) > MAX_METRES) or 0 < image_width <= TINY_IMAGE_WIDTH:
        return ''
    seen = points[score > 0]
    if len(seen) < MIN_JUDGED_POINTS:
        return ''
    low, high = NORMALISED_RANGE
    if ((seen >= low) & (seen <= high)).all():
        return Fault.NORMALISED.value
    if (seen < low).any():
        return Fault.METRES.value
    return ''


def describe_rate(times: Array, longest_s: float = MAX_STEP_S) -> str:
    """Describe in a clause that times (F,) in s can be those of no video; empty if they may be, or are too few."""
    if len(times) < MIN_JUDGED_FRAMES:
        return ''
    steps = np.diff(times)
    return describe_step(float(np.median(steps) or steps.mean()), longest_s)


def describe_step(step_s: float, longest_s: float = MAX_STEP_S) -> str:
    """Describe in a clause that a step in s from image to image is that of no video; empty if it may be one."""
    if step_s <= 0 or MIN_STEP_S <= step_s <= longest_s:
        return ''
    if step_s > longest_s:
        unit = next((unit for n, unit in enumerate(UNITS) if step_s <= MAX_STEP_S * 1000**n), UNITS[-1])
        return Fault.RATE_LOW.describe(step_s=step_s, unit=unit)
    unit = next((unit for n, unit in enumerate(UNITS[::-1]) if step_s * 1000**n >= MIN_STEP_S), UNITS[0])
    return Fault.RATE_HIGH.describe(rate=1 / step_s, unit=unit)


def measure_distance(mean: Array, size: tuple[float, float]) -> float:
    """Return d (formula of `PointPlaces`) of the mean position (2,) of points in an image; both in px."""
    return float((((mean / size - MIDDLE) / SPREAD) ** 2).sum())


class PointPlaces:
    """Where the points of people lie over many images of one size, which shows whether it is their size.

    People are mostly in the middle of an image: with m the mean position of their points,

        d(width, height) = ((m_x / width - MIDDLE_x) / SPREAD_x)^2 + ((m_y / height - MIDDLE_y) / SPREAD_y)^2

    Another size, which holds the points, is likelier if its d / 2 is smaller by `MIN_EVIDENCE`: width and height
    exchanged, half of both, and one and a half times both where points lie beyond the image.
    """

    def __init__(self) -> None:
        self._begin((0, 0))

    def _begin(self, image_size: tuple[int, int]) -> None:
        self._size, self._count, self._sum = image_size, 0.0, np.zeros(2)
        self._inside = np.zeros(1 + len(OTHER_SIZES))  # numbers of points inside this size and the others

    def add(self, points: Array, score: Array, image_size: tuple[int, int], kept: float = 1.0) -> None:
        """Add points (..., 2) px with scores (...), of a size or a new one; a share is kept of those before."""
        if image_size != self._size:
            self._begin(image_size)
        seen = points[score > 0]
        inside = [((seen >= 0) & (seen <= size)).all(axis=-1).sum() for size in (image_size, *self._list_others())]
        self._count = kept * self._count + len(seen)
        self._sum = kept * self._sum + seen.sum(axis=0)
        self._inside = kept * self._inside + inside

    @property
    def share_outside(self) -> float:
        """The share of the points that lie outside the image; 0 if there are too few."""
        return 1 - float(self._inside[0]) / self._count if self._count >= MIN_JUDGED_POINTS else 0.0

    def judge(self) -> Finding:
        """Return whether most points lie outside, so that the size is wrong, or as in an image of another size."""
        is_held = self._inside / max(self._count, 1) >= MIN_SHARE_HELD
        outside = self.share_outside
        if outside > MAX_SHARE_OUTSIDE:
            fault = Fault.SIZE_TRANSPOSED_OUTSIDE if is_held[1] else Fault.SIZE_OUTSIDE
            return self._find(fault, Grade.WRONG)
        if self._count < MIN_JUDGED_POINTS:
            return SOUND
        mean = self._sum / self._count
        own, *others = (measure_distance(mean, size) for size in (self._size, *self._list_others()))
        is_beyond = outside > MIN_SHARE_BEYOND
        evidence = (own - np.array(others)) / 2 + [0.0, 0.0, BEYOND_EVIDENCE if is_beyond else -math.inf]
        evidence = np.where(is_held[1:], evidence, -math.inf)
        likeliest = [*OTHER_SIZES][evidence.argmax()]
        return self._find(likeliest, Grade.DOUBTFUL) if evidence.max() >= MIN_EVIDENCE else SOUND

    def _find(self, fault: Fault, grade: Grade) -> Finding:
        width, height = self._size
        return fault.found(grade, outside=self.share_outside, width=width, height=height)

    def _list_others(self) -> list[tuple[float, float]]:
        width, height = self._size
        return [(x * width + y * height, x * height + y * width) for x, y in OTHER_SIZES.values()]


def check_places(points: Array, score: Array, image_size: tuple[int, int]) -> str:
    """Describe in a clause that most keypoints lie outside the image, or return an empty string.

    Raises:
        InputError: they do, but inside it with the sides exchanged.
    """
    places = PointPlaces()
    places.add(points, score, image_size)
    finding = places.judge()
    if finding.fault is Fault.SIZE_TRANSPOSED_OUTSIDE:
        raise InputError(finding.words)
    return finding.words if finding.grade is Grade.WRONG else ''
