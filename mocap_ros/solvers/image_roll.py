# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""By how much images of people are turned about the optical axis for the lifter, which knows only upright cameras.

A vertical that is given points up in the turned image. Where none is given, the image is turned by half a turn if
the camera is upside down, by a quarter if it is on its side, and else not at all. It is upside down if people are
so in its image, from the feet to the head, and yet have no hand beyond the head, on which they could stand: for
more than half the time, and `TURNED_FACTOR` times as long as others are upright. Who is on the side may lie, or
stand before a camera on its side. But who lies does not travel across the body: the camera of a whole sequence is
on its side where one does. (Of 845 persons of motion capture who were laid on the floor none does, of 72 who
walk three quarters do. Who lies changes the length in the image as one who walks away does.) Live this is not
decided.

Live, the first frame with people decides, and later ones once they say the contrary for `TURNED_S`. What was long
ago counts less, as for the vertical. The poses are turned back at once: a decision changes the lifted poses of new
frames alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.vertical import MAX_STEP_S, MEMORY_S
from mocap_ros.units import NS_PER_S

LOOK_S = 0.1  # s, after which a tracker looks again
MAX_TILT_DEG = 45.0  # degrees from up or down in the image, within which a body is upright or upside down
# Who is on the side for so much of the time, 1, and travels by more than so many lengths of trunk and leg, between
# quantiles of the time, stands before a camera on its side
SIDEWAYS_SHARE, MIN_TRAVEL, TRAVEL_QUANTILES = 0.9, 1.0, (0.05, 0.95)
TURNED_S, TURNED_FACTOR = 0.5, 4.0  # s, 1; a somersault is shorter
MIN_IN_IMAGE = (
    0.3  # 1; sine of the angle from the optical axis below which a vertical has no direction in the image
)
HEAD_SHARE = 0.25  # 1; of the length from legs to head and shoulders, by which the top of the head is above these
_HANDS = [CMU15.index(name) for name in ('lwrist', 'rwrist')]
# (3, J) parts of the body: head and shoulders, legs, and the hips for those whose legs are not seen
_PARTS = np.array([
    np.isin(CMU15.joints, names)
    for names in (
        ('head', 'neck', 'lshoulder', 'rshoulder'), ('lankle', 'rankle', 'lknee', 'rknee'), ('lhip', 'rhip')
    )
]).astype(float)  # fmt: skip


def find_roll(upward: Array) -> float:
    """Return the angle in rad by which to turn an image, clockwise, so that a direction (3,) points up in it.

    It is 0 where the direction lies nearly along the optical axis.
    """
    if math.hypot(upward[0], upward[1]) < MIN_IN_IMAGE:
        return 0.0
    return -math.atan2(float(upward[0]), -float(upward[1]))


def find_sides(points: Array, weight: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether bodies are upright in the image, and whether they are upside down and not on their hands.

    Both (N,) are False where too little is seen. Points (N, J, 2) are those of `CMU15`, with weights (N, J).
    """
    means, counts = _find_parts(points, weight)
    is_known = (counts[:, 0] > 0) & (counts[:, 1] + counts[:, 2] > 0)
    up = means[:, 0] - np.where(counts[:, 1:2] > 0, means[:, 1], means[:, 2])
    up = np.where(is_known[:, None], up, 0.0)
    length = np.hypot(up[:, 0], up[:, 1])
    limit = math.cos(math.radians(MAX_TILT_DEG)) * length
    is_upside_down = up[:, 1] > limit
    if is_upside_down.any():
        is_seen = weight[:, _HANDS] > 0
        along = (points[:, _HANDS] - means[:, :1]) @ up[..., None] / np.maximum(length, 1e-9)[:, None, None]
        is_beyond = is_seen & (along[..., 0] > HEAD_SHARE * length[:, None])
        is_upside_down &= is_seen.any(axis=1) & ~is_beyond.any(axis=1)
    return (-up[:, 1] > limit), is_upside_down


def _find_parts(points: Array, weight: Array) -> tuple[Array, Array]:
    """Return the means (N, 3, 2) of the seen joints of the `_PARTS`, and the numbers (N, 3) of these joints."""
    parts = _PARTS * (weight > 0)[:, None]
    counts = parts.sum(axis=2)
    return (parts @ points) / np.maximum(counts, 1.0)[..., None], counts


def find_camera_roll(points: Array, weight: Array, times: Array) -> float:
    """Return the angle in rad by which to turn the images of a sequence clockwise: 0, half or a quarter of a turn.

    Points (F, J, 2) and weights (F, J) are those of `find_sides`.
    """
    steps = np.minimum(np.diff(times, append=times[-1]), MAX_STEP_S)
    steps[-1] = steps[-2] if len(steps) > 1 else MAX_STEP_S
    is_seen = (weight > 0).any(axis=1)
    seen_s = float(steps @ is_seen)
    upright_s, turned_s = (float(steps @ side) for side in find_sides(points, weight))
    if turned_s > max(TURNED_FACTOR * upright_s, seen_s / 2):
        return math.pi
    for roll in (math.pi / 2, -math.pi / 2):
        turned = turn_about_axis(points, roll)
        is_upright = find_sides(turned, weight)[0]
        if float(steps @ is_upright) > SIDEWAYS_SHARE * seen_s:
            return roll if measure_travel(turned[is_upright], weight[is_upright]) > MIN_TRAVEL else 0.0
    return 0.0


def measure_travel(points: Array, weight: Array) -> float:
    """Return how far a person has travelled from side to side of the image, in lengths of trunk and leg.

    Points (F, J, 2) and weights (F, J) are those of `find_sides`.
    """
    means, counts = _find_parts(points, weight)
    upper, legs, hips = np.moveaxis(means, 1, 0)
    length = np.linalg.norm(upper - hips, axis=1) + np.linalg.norm(hips - legs, axis=1)
    is_whole = (counts > 0).all(axis=1) & (length > 0)
    if not is_whole.any():
        return 0.0
    low, high = np.quantile(hips[is_whole, 0], TRAVEL_QUANTILES)
    return float((high - low) / np.quantile(length[is_whole], 0.9))


@dataclass
class CameraSide:
    """Whether a camera is upside down, frame by frame.

    Attributes:
        is_upside_down: what is known so far.
        seen_s: s, for which people were seen, those of long ago counting less.
        upright_s: s, for which they were upright, likewise.
        turned_s: s, for which they were upside down and did not stand on the hands, likewise.
        stamp_ns: ns, stamp of the newest frame with people; None before the first.
    """

    is_upside_down: bool = False
    seen_s: float = 0.0
    upright_s: float = 0.0
    turned_s: float = 0.0
    stamp_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether to look at the people of a frame, stamp in ns."""
        return self.stamp_ns is None or stamp_ns - self.stamp_ns >= LOOK_S * NS_PER_S

    def advance(self, stamp_ns: int, points: Array, weight: Array) -> None:
        """Look at the P > 0 people of a new frame, stamp in ns; points (P, J, 2) and weights (P, J) as above."""
        upright, turned = (int(side.sum()) for side in find_sides(points, weight))
        if self.stamp_ns is None:
            self.is_upside_down = turned > max(TURNED_FACTOR * upright, len(points) / 2)
        age_s = 0.0 if self.stamp_ns is None else (stamp_ns - self.stamp_ns) / NS_PER_S
        kept, step_s = math.exp(-age_s / MEMORY_S), min(age_s, MAX_STEP_S)
        self.stamp_ns = stamp_ns
        self.seen_s = kept * self.seen_s + step_s * len(points)
        self.upright_s = kept * self.upright_s + step_s * upright
        self.turned_s = kept * self.turned_s + step_s * turned
        against_s, for_s = (
            (self.upright_s, self.turned_s) if self.is_upside_down else (self.turned_s, self.upright_s)
        )
        if against_s > max(TURNED_S, TURNED_FACTOR * for_s, self.seen_s / 2):
            self.is_upside_down = not self.is_upside_down


def turn_about_axis(vectors: Array, roll: float) -> Array:
    """Return points (..., 2) or vectors (..., 3) turned clockwise about the optical axis by an angle in rad."""
    if roll == 0:
        return vectors
    turned, x, y = vectors.copy(), vectors[..., 0], vectors[..., 1]
    turned[..., 0] = math.cos(roll) * x - math.sin(roll) * y
    turned[..., 1] = math.sin(roll) * x + math.cos(roll) * y
    return turned
