# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in the input that no single message shows: joints in another order, and images of another size.

Something is doubted that is so for most people over seconds. With x_i the share of the people of frame i for whom
it is so, and dt_i the time for which that frame stands,

    n = sum_i k_i dt_i,    m = sum_i k_i dt_i x_i,    k_i = exp(-(t - t_i) / T),

it is doubted once n is at least S and m at least the share P of it. Frames without people do not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mocap_ros.keypoints.person import Person2D
from mocap_ros.people import Person3D
from mocap_ros.units import NS_PER_S

MEMORY_S = 5.0  # s; T: a corrected mistake is forgotten soon
LEAST_S = 2.5  # s; S: longer than a burst of wrong points, such as while somebody enters the image
LEAST_SHARE = 0.8  # 1; P: one person with right points among several shows that the order is right
MAX_STEP_S = 0.2  # s; longest time that one frame stands for
# 1; RMS residual divided by the body radius. With it, none of 75 recordings of motion capture with the errors of
# three detectors is doubted, and 36 of 36 with joints in another order are (reversed, one on, or random).
MAX_RESIDUAL = 0.35
MAX_OUTSIDE = 0.5  # 1; share of a person's points: some detectors guess legs that the image cuts off


class LastingDoubt:
    """Whether something is so for most people over seconds."""

    def __init__(self) -> None:
        self._seconds = self._doubted_seconds = 0.0  # n and m of the module
        self._stamp_ns: int | None = None

    def advance(self, stamp_ns: int, is_so: Sequence[bool]) -> bool:
        """Return whether something is doubted.

        Args:
            stamp_ns: ns, stamp of the frame.
            is_so: For each person in it, whether it is so.
        """
        age_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        if age_s < 0:  # the stamps began anew
            self._seconds = self._doubted_seconds = age_s = 0.0
        kept, step = math.exp(-age_s / MEMORY_S), min(age_s, MAX_STEP_S)
        self._seconds *= kept
        self._doubted_seconds *= kept
        if is_so:
            self._seconds += step
            self._doubted_seconds += step * sum(is_so) / len(is_so)
        return self._seconds >= LEAST_S and self._doubted_seconds >= LEAST_SHARE * self._seconds


class InputDoubts:
    """Checks of the keypoints of successive images of one camera."""

    def __init__(self) -> None:
        self._joint_order, self._image_size = LastingDoubt(), LastingDoubt()

    def advance(
        self,
        stamp_ns: int,
        detections: Sequence[Person2D],
        people: Sequence[Person3D],
        image_size: tuple[int, int] | None,
    ) -> tuple[str, ...]:
        """Return what is doubted, each in words; usually nothing.

        Args:
            stamp_ns: ns, stamp of the image.
            detections: The people whom the detector saw in it.
            people: The people who were reconstructed up to it.
            image_size: px, width and height of the image; None if they are unknown.
        """
        residuals = [p.motion.residual for p in people if not p.predicted and math.isfinite(p.motion.residual)]
        doubts = []
        if self._joint_order.advance(stamp_ns, [r > MAX_RESIDUAL for r in residuals]) and residuals:
            doubts.append(
                'people: no person has joints where the points are: beside the skeletons by '
                f'{np.mean(residuals):.2f} of the radius of a body; check that skeleton or joint_names of the '
                'messages give the joints in the order of the points'
            )
        shares = [_find_share_outside(p, image_size) for p in detections] if image_size else []
        if self._image_size.advance(stamp_ns, [s > MAX_OUTSIDE for s in shares]) and image_size:
            doubts.append(
                f'people: most points lie outside the image of {image_size[0]} x {image_size[1]} px; check that '
                'the detector sees images of that size, and gives points in px from the upper left corner'
            )
        return tuple(doubts)


def _find_share_outside(person: Person2D, image_size: tuple[int, int]) -> float:
    """Return the share of the seen points of a person that lie outside an image of this size in px."""
    seen = person.points[person.score > 0]
    return float(((seen < 0) | (seen > image_size)).any(axis=1).mean()) if len(seen) else 0.0
