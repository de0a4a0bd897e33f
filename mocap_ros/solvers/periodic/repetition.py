# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The largest repetition r (`engine.periodic.measure_repetition`) over all cadences of a walk or a run.

It says cheaply that a motion cannot be periodic.
"""

from __future__ import annotations

import math

from mocap_ros.arrays import Array
from mocap_ros.engine import periodic as engine
from mocap_ros.solvers.periodic.fourier import MAX_CADENCE_HZ, MIN_CADENCE_HZ, MIN_CYCLES

NEWEST_S, MAX_STRETCH = engine.REPETITION  # explained there
EPSILON = 1e-9  # of the longest cycle that is known; keeps rounding from making it longer
# of the longest cycle that may be fitted; motion that is known for less than that may repeat itself later
MIN_SHARE_OF_CYCLE = 0.75


def measure_best_repetition(times: Array, theta: Array) -> float:
    """Return the largest r over all cadences; NaN if the motion is known for too short a time.

    `times` (F,) s, increasing; `theta` (F, K) m, base-pose weights at these times.
    """
    span_s = float(times[-1] - times[0])
    longest_s = span_s - NEWEST_S
    if longest_s < MIN_SHARE_OF_CYCLE / max(MIN_CADENCE_HZ, MIN_CYCLES / max(span_s, NEWEST_S)):
        return math.nan
    # the lengths of cycles that `measure_repetition` tries for one cadence end where those of the next begin
    step = (1 + MAX_STRETCH) / (1 - MAX_STRETCH)
    count = math.ceil(math.log(longest_s * MAX_CADENCE_HZ, step))
    cycles_s = [*(step**i / MAX_CADENCE_HZ for i in range(count)), longest_s * (1 - EPSILON)]
    found = [engine.measure_repetition(times, theta, 1 / cycle_s) for cycle_s in cycles_s]
    return max((r for r in found if not math.isnan(r)), default=math.nan)
