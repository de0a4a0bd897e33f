# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Who was seen in a recording, from when to when, and in which motion."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from mocap_ros.people import MotionKind, People, Person3D
from mocap_ros.units import NS_PER_S


@dataclass
class Appearance:
    """A person from the first to the last time of being seen, or predicted."""

    person: str  # id of the person
    from_ns: int  # ns, stamp of the first frame
    to_ns: int  # ns, stamp of the last frame
    # S in each kind of motion, by the name of the kind in small letters, without those in which the person was
    # away
    seconds: dict[str, float] = field(default_factory=lambda: {kind.name.lower(): 0.0 for kind in MotionKind})
    # Frames in periodic motion by cadence in Hz, rounded, so that memory does not grow with them
    cadences: Counter[float] = field(default_factory=Counter)
    residual_sum: float = 0.0  # px, sum and number of the reprojection errors of frames that show the person
    residual_count: int = 0

    @property
    def cadence(self) -> float:
        """Median cadence over the frames in periodic motion in Hz; NaN if there is none."""
        values = sorted(self.cadences)
        counts = np.cumsum([self.cadences[value] for value in values])
        return values[int(np.searchsorted(counts, counts[-1] / 2))] if values else math.nan

    @property
    def residual(self) -> float:
        """Mean reprojection error in px over the frames that show the person; NaN if unknown."""
        return self.residual_sum / self.residual_count if self.residual_count else math.nan

    def extend(self, stamp_ns: int, person: Person3D, gap_s: float) -> None:
        """Add a frame; one later than `gap_s` after the last counts as no time in motion."""
        motion, step_s = person.motion, (stamp_ns - self.to_ns) / NS_PER_S
        self.seconds[motion.kind.name.lower()] += step_s if step_s <= gap_s else 0.0
        self.to_ns = stamp_ns
        if motion.kind is MotionKind.PERIODIC and motion.cadence > 0:
            self.cadences[round(motion.cadence, 2)] += 1
        if not person.predicted and np.isfinite(person.reprojection_residual):
            self.residual_sum += person.reprojection_residual
            self.residual_count += 1


class AppearanceLog:
    """Collects the appearances of people, frame by frame; tentative people are left out.

    A person who was away for more than `absence_s` and comes back under the same id appears anew. Between two
    frames more than `gap_s` apart, the person was away, and the time counts as no motion.
    """

    def __init__(self, absence_s: float, gap_s: float) -> None:
        self._gap_s = gap_s
        self._absence_ns = absence_s * NS_PER_S
        self._newest: dict[str, Appearance] = {}  # by id of the person
        self._all: list[Appearance] = []

    def add(self, stamp_ns: int, people: People) -> None:
        """Add the people of a frame."""
        for person in (p for p in people if not p.tentative):
            known = self._newest.get(person.id)
            if known is None or not 0 <= stamp_ns - known.to_ns <= self._absence_ns:
                known = self._newest[person.id] = Appearance(person.id, stamp_ns, stamp_ns)
                self._all.append(known)
            known.extend(stamp_ns, person, self._gap_s)

    def list_all(self) -> tuple[Appearance, ...]:
        """Return all appearances, in the order in which they began."""
        return tuple(sorted(self._all, key=lambda a: (a.from_ns, a.person)))
