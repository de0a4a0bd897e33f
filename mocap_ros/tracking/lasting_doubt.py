# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether something is so for most people over seconds.

With x_i the share of the people of frame i for whom it is so, and dt_i the time for which that frame stands,

    n = sum_i k_i dt_i,    m = sum_i k_i dt_i x_i,    k_i = exp(-(t - t_i) / T)

it is doubted once n is at least S and m at least the share P of n. Frames without people do not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mocap_ros.units import NS_PER_S

LEAST_SHARE = 0.8  # 1; P: one person among several for whom it is not so speaks against the doubt
MAX_STEP_S = 1.0  # s; longest time that one frame stands for, so that a stream of 1 Hz still reaches S


class LastingDoubt:
    """Whether something has been so for most people over the last seconds; it is told frame by frame.

    Args:
        memory_s: s, T.
        least_s: s, S.
    """

    def __init__(self, memory_s: float, least_s: float) -> None:
        self._memory_s, self._least_s = memory_s, least_s
        self._seconds = self._doubted_seconds = 0.0  # n and m of the module
        self._stamp_ns: int | None = None

    def advance(self, stamp_ns: int, is_so: Sequence[bool]) -> bool:
        """Return whether something is doubted.

        Args:
            stamp_ns: ns, stamp of the frame.
            is_so: for each person in it, whether it is so.
        """
        age_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        if age_s < 0:  # the stamps began anew
            self._seconds = self._doubted_seconds = age_s = 0.0
        kept, step = math.exp(-age_s / self._memory_s), min(age_s, MAX_STEP_S)
        self._seconds *= kept
        self._doubted_seconds *= kept
        if is_so:
            self._seconds += step
            self._doubted_seconds += step * sum(is_so) / len(is_so)
        return self._seconds >= self._least_s and self._doubted_seconds >= LEAST_SHARE * self._seconds
