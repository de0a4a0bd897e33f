# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Check of a given vertical against how people stand: where they contradict it, it is wrong, or they all lie.

The directions upwards that poses tell (`models.upward_direction`) are compared with it in every frame, over the
time

    n = sum_i k_i dt_i,    m = sum_i k_i dt_i [angle_i > A],    k_i = exp(-(t - t_i) / T)

of all people; it is doubted once n is at least S and m at least the share P of it. A wrong vertical is told to the
lifter, so poses lean towards it, and errors below 60 degrees are hardly seen; a wrong sign or axis is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.upward_direction import find_upward
from mocap_ros.people import Person3D
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

MAX_ANGLE_DEG = 40.0  # A: who sits or bends down is below it, who lies is above
MEMORY_S = 20.0  # s; T: as long as a vertical that is found is remembered
LEAST_S = 5.0  # s; S: longer than it takes to fall or to lie down for an exercise
LEAST_SHARE = 0.8  # 1; P: somebody who stands among people who lie confirms the vertical
MAX_STEP_S = 0.2  # s; longest time that one frame stands for


class VerticalCheck:
    """Comparison of a given vertical with how people stand, over successive frames."""

    def __init__(self) -> None:
        self._seconds = self._off_seconds = 0.0  # n and m of the module
        self._stamp_ns: int | None = None
        self._angle_deg = 0.0

    def advance(self, stamp_ns: int, people: Sequence[Person3D], vertical: Array) -> float | None:
        """Return the angle in degrees by which people contradict the vertical; None if they do not.

        Args:
            stamp_ns: ns, stamp of the frame.
            people: the people in it, in the camera's optical frame.
            vertical: (3,) unit vector upwards in that frame, which was given.
        """
        age_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        if age_s < 0:  # the stamps began anew
            self._seconds = self._off_seconds = age_s = 0.0
        kept, step = math.exp(-age_s / MEMORY_S), min(age_s, MAX_STEP_S)
        self._seconds *= kept
        self._off_seconds *= kept
        seen = [p.core for p in people if not (p.tentative or p.predicted)]
        cosines = find_upward(np.array(seen)) @ vertical if seen else np.zeros(0)
        angles = np.degrees(np.arccos(cosines[np.isfinite(cosines)].clip(-1, 1)))
        off = angles[angles > MAX_ANGLE_DEG]
        self._seconds += step * len(angles)
        self._off_seconds += step * len(off)
        if len(off):
            self._angle_deg = float(off.mean())
        is_doubted = self._seconds >= LEAST_S and self._off_seconds >= LEAST_SHARE * self._seconds
        return self._angle_deg if is_doubted else None
