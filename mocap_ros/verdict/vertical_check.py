# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether people contradict a given vertical for seconds.

With x_i the share of the people of frame i who do, and dt_i the time for which that frame stands,

    n = sum_i k_i dt_i,    m = sum_i k_i dt_i x_i,    k_i = exp(-(t - t_i) / T)

they do once n is at least S and m at least the share P of n. Frames without people do not count.

The directions upwards that poses show (`models.upward_direction`) are compared with the vertical in every frame.
The lifter takes a wrong vertical for a right one, so poses lean towards it, and errors below 60 degrees are hardly
seen; a wrong sign or axis is. So it is if all people lie.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.upward_direction import Stances
from mocap_ros.people import People
from mocap_ros.units import NS_PER_S

LEAST_SHARE = 0.8  # 1; P: one person among several for whom it is not so speaks against it
MAX_STEP_S = 1.0  # s; longest time that one frame stands for, so that a stream of 1 Hz still reaches S
MAX_ANGLE_DEG = 40.0  # who sits or bends down is below it, who lies is above
MEMORY_S = 20.0  # s; T, as long as a vertical that is found is remembered
LEAST_S = 5.0  # s; S, longer than it takes to fall or to lie down for an exercise


class VerticalCheck:
    """Comparison of a given vertical with how people stand, over successive frames."""

    def __init__(self) -> None:
        self._seconds = self._seconds_off = 0.0  # n and m of the module
        self._stamp_ns: int | None = None
        self._degrees_off = 0.0  # the sum of m with the angles as factors

    def advance(self, stamp_ns: int, people: People, vertical: NDArray[np.float64]) -> float | None:
        """Return the mean angle in degrees by which people contradict a vertical (3,); None if they do not."""
        seen = people.core[~(people.tentative | people.predicted)]
        cosines = Stances.of(seen).upward @ vertical
        angles = np.degrees(np.arccos(cosines[np.isfinite(cosines)].clip(-1, 1)))
        is_off = angles > MAX_ANGLE_DEG
        age_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        if age_s < 0:  # the stamps began anew
            self._seconds = self._seconds_off = self._degrees_off = age_s = 0.0
        kept, step_s = math.exp(-age_s / MEMORY_S), min(age_s, MAX_STEP_S) if is_off.size else 0.0
        self._seconds = kept * self._seconds + step_s
        self._seconds_off = kept * self._seconds_off + step_s * (is_off.mean() if is_off.size else 0.0)
        angle_deg = float((angles * is_off).mean()) if is_off.size else 0.0
        self._degrees_off = kept * self._degrees_off + step_s * angle_deg
        lasts = self._seconds >= LEAST_S and self._seconds_off >= LEAST_SHARE * self._seconds
        return self._degrees_off / self._seconds_off if lasts else None
