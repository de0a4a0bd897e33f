# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Who was seen in a recording, from when to when, and in which motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mocap_ros.people import MotionKind, Person3D
from mocap_ros.units import NS_PER_S


@dataclass
class Appearance:
    """A person from the first to the last time of being seen, or predicted.

    Attributes:
        person: id of the person.
        from_ns: ns, stamp of the first frame.
        to_ns: ns, stamp of the last frame.
        seconds: s in each kind of motion, by the name of the kind in small letters, without those in which the
            person was away.
        cadence: Hz, median over the frames in periodic motion; NaN if there is none.
        residual: px, mean reprojection error over the frames in which the person was seen; NaN if unknown.
    """

    person: str
    from_ns: int
    to_ns: int
    seconds: dict[str, float] = field(default_factory=lambda: {kind.name.lower(): 0.0 for kind in MotionKind})
    cadence: float = float('nan')
    residual: float = float('nan')


class AppearanceLog:
    """Collects the appearances of people, frame by frame; tentative people are left out.

    Args:
        absence_s: s; somebody who was away for longer and comes back under the same id appears anew.
        gap_s: s; between two frames further apart, the person was away, and the time counts as no motion.
    """

    def __init__(self, absence_s: float, gap_s: float) -> None:
        self._gap_s = gap_s
        self._absence_ns = absence_s * NS_PER_S
        self._known: dict[str, _Record] = {}
        self._finished: list[Appearance] = []

    def add(self, stamp_ns: int, people: Sequence[Person3D]) -> None:
        """Add the people of a frame."""
        for person in people:
            if person.tentative:
                continue
            record = self._known.get(person.id)
            if record is None or not 0 <= stamp_ns - record.appearance.to_ns <= self._absence_ns:
                if record is not None:
                    self._finished.append(record.finish())
                record = self._known[person.id] = _Record(Appearance(person.id, stamp_ns, stamp_ns))
            record.add(stamp_ns, person, self._gap_s)

    def finish(self) -> tuple[Appearance, ...]:
        """Return all appearances, in the order in which they began."""
        appearances = [*self._finished, *(record.finish() for record in self._known.values())]
        self._finished, self._known = [], {}
        return tuple(sorted(appearances, key=lambda a: (a.from_ns, a.person)))


@dataclass
class _Record:
    """An appearance that has not ended.

    Attributes:
        appearance: what is known so far.
        cadences: frames by cadence in Hz, rounded, so that memory does not grow with the recording.
        residual_sum: px, sum of the known residuals.
        residual_count: number of the known residuals.
    """

    appearance: Appearance
    cadences: dict[float, int] = field(default_factory=dict)
    residual_sum: float = 0.0
    residual_count: int = 0

    def add(self, stamp_ns: int, person: Person3D, gap_s: float) -> None:
        appearance, motion = self.appearance, person.motion
        step_s = (stamp_ns - appearance.to_ns) / NS_PER_S
        appearance.seconds[motion.kind.name.lower()] += step_s if step_s <= gap_s else 0.0
        appearance.to_ns = stamp_ns
        if motion.kind is MotionKind.PERIODIC and motion.cadence > 0:
            rounded = round(motion.cadence, 2)
            self.cadences[rounded] = self.cadences.get(rounded, 0) + 1
        if not person.predicted and np.isfinite(person.residual):
            self.residual_sum += person.residual
            self.residual_count += 1

    def finish(self) -> Appearance:
        if self.cadences:
            values = sorted(self.cadences)
            counts = np.cumsum([self.cadences[value] for value in values])
            self.appearance.cadence = values[int(np.searchsorted(counts, counts[-1] / 2))]
        if self.residual_count:
            self.appearance.residual = self.residual_sum / self.residual_count
        return self.appearance
