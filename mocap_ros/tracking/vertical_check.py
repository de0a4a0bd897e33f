# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Check of a given vertical against how people stand: where they contradict it, it is wrong, or they all lie.

The directions upwards that poses tell (`models.upward_direction`) are compared with it in every frame. A
difference of more than `MAX_ANGLE_DEG` that lasts is a doubt (`lasting_doubt.py`). The lifter takes a wrong
vertical for a right one, so poses lean towards it, and errors below 60 degrees are hardly seen; a wrong sign or
axis is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.upward_direction import find_upward
from mocap_ros.people import Person3D
from mocap_ros.tracking.lasting_doubt import LastingDoubt

Array = NDArray[np.float64]

MAX_ANGLE_DEG = 40.0  # who sits or bends down is below it, who lies is above
MEMORY_S = 20.0  # s; as long as a vertical that is found is remembered
LEAST_S = 5.0  # s; longer than it takes to fall or to lie down for an exercise


class VerticalCheck:
    """Comparison of a given vertical with how people stand, over successive frames."""

    def __init__(self) -> None:
        self._doubt = LastingDoubt(MEMORY_S, LEAST_S)
        self._angle_deg = 0.0

    def advance(self, stamp_ns: int, people: Sequence[Person3D], vertical: Array) -> float | None:
        """Return the angle in degrees by which people contradict the vertical; None if they do not.

        Args:
            stamp_ns: ns, stamp of the frame.
            people: the people in it, in the camera's optical frame.
            vertical: (3,) unit vector upwards in that frame, which was given.
        """
        seen = [p.core for p in people if not (p.tentative or p.predicted)]
        cosines = find_upward(np.array(seen)) @ vertical if seen else np.zeros(0)
        angles = np.degrees(np.arccos(cosines[np.isfinite(cosines)].clip(-1, 1)))
        is_off = angles > MAX_ANGLE_DEG
        if is_off.any():
            self._angle_deg = float(angles[is_off].mean())
        return self._angle_deg if self._doubt.advance(stamp_ns, is_off.tolist()) else None
