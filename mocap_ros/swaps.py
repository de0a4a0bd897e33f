"""Left and right swapped by the detector: recognised by how limbs move, and undone.

A hidden Markov chain with two states, labels right or swapped, decoded by Viterbi's algorithm. Each of the two
histories that survive carries the image points as it has relabelled them and predicts the next from their motion;
a frame's cost is how far its points, under either labelling, are from that prediction. So a later frame may change
the verdict on earlier ones, as far back as the window reaches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.association import extent

Array = NDArray[np.float64]

ENTER, LEAVE = 0.01, 0.15
SPREAD, SPREAD_PER_S = 0.05, 1.0
MOST_COST = 9.0
VELOCITY_TIME = 0.06
FRAME_TIME = 1 / 30


@dataclass(frozen=True, eq=False)
class History:
    """One surviving history.

    Attributes:
        cost: minus its log likelihood, up to a constant.
        swapped: verdict on each frame of the window.
        points: (J, 2) last relabelled ones; velocity: (J, 2) per s; seen: (J,) s of the last sight.
    """

    cost: float
    swapped: tuple[bool, ...]
    points: Array
    velocity: Array
    seen: Array

    def predicted(self, time: float) -> tuple[Array, Array]:
        """(J, 2) points at that time and (J,) their spread in body sizes."""
        age = time - self.seen
        moved = self.velocity * VELOCITY_TIME * (1 - np.exp(-age / VELOCITY_TIME))[:, None] * 2
        return self.points + moved, SPREAD + SPREAD_PER_S * age

    def then(self, time: float, points: Array, seen: NDArray[np.bool_], swapped: bool, cost: float) -> History:
        """Continued by a frame with these relabelled points."""
        age = np.maximum(time - self.seen, 1e-3)[:, None]
        fresh = (points - self.points) / age
        known = np.isfinite(self.seen)[:, None] & (age < 0.2)
        blend = 1 - np.exp(-age / VELOCITY_TIME)
        velocity = np.where(known, self.velocity + blend * (fresh - self.velocity), 0.0)
        take = seen[:, None]
        return History(
            self.cost + cost,
            (*self.swapped, swapped),
            np.where(take, points, self.points),
            np.where(take, velocity, self.velocity),
            np.where(seen, time, self.seen),
        )


@dataclass(frozen=True, eq=False)
class SwapFilter:
    """Both histories of one person: the labels of the newest frame right, and swapped.

    Attributes:
        mirror: (J,) index of each joint's counterpart.
        enabled: False to believe the detector.
    """

    mirror: NDArray[np.intp]
    enabled: bool = True
    histories: tuple[History, History] | None = None

    def update(self, time: float, points: Array, weight: Array, size: float) -> SwapFilter:
        """With one frame more.

        Args:
            time: s.
            points: (J, 2) as the detector labelled them.
            weight: (J,), 0 where not seen.
            size: of the body in the units of the points.
        """
        if not self.enabled:
            return replace(self, histories=self._believed(points))
        labelled = [(points, weight > 0), (points[self.mirror], weight[self.mirror] > 0)]
        if self.histories is None:
            start = [
                History(cost, (swapped,), p, np.zeros_like(p), np.where(seen, time, -np.inf))
                for cost, swapped, (p, seen) in zip((0.0, 3.0), (False, True), labelled, strict=True)
            ]
            return replace(self, histories=(start[0], start[1]))
        before = self.histories
        steps = max(time - float(before[0].seen.max()), 1e-3) / FRAME_TIME
        enter, leave = 1 - (1 - ENTER) ** steps, 1 - (1 - LEAVE) ** steps
        change = -np.log([[1 - enter, enter], [leave, 1 - leave]])
        now = []
        for to, (p, seen) in enumerate(labelled):
            ways = [h.cost + self._surprise(h, time, p, seen, size) + change[i, to] for i, h in enumerate(before)]
            best = int(np.argmin(ways))
            now.append(before[best].then(time, p, seen, bool(to), ways[best] - before[best].cost))
        least = min(h.cost for h in now)
        first, second = (replace(h, cost=h.cost - least) for h in now)
        return replace(self, histories=(first, second))

    def _believed(self, points: Array) -> tuple[History, History]:
        before = () if self.histories is None else self.histories[0].swapped
        history = History(0.0, (*before, False), points, np.zeros_like(points), np.zeros(len(points)))
        return history, replace(history, cost=np.inf)

    def _surprise(
        self, history: History, time: float, points: Array, seen: NDArray[np.bool_], size: float
    ) -> float:
        """Minus the log likelihood of the points of paired joints."""
        sides = (self.mirror != np.arange(len(self.mirror))) & seen & np.isfinite(history.seen)
        if not sides.any():
            return 0.0
        with np.errstate(invalid='ignore'):
            expected, spread = history.predicted(time)
        squared = (((points - expected)[sides] / size) ** 2).sum(axis=-1) / spread[sides] ** 2
        return float((MOST_COST * np.log1p(0.5 * squared / MOST_COST) + 2 * np.log(spread[sides])).sum())

    def forgot(self, frames: int) -> SwapFilter:
        """Without the verdicts on the oldest frames."""
        if self.histories is None or frames == 0:
            return self
        first, second = (replace(h, swapped=h.swapped[frames:]) for h in self.histories)
        return replace(self, histories=(first, second))

    @property
    def verdict(self) -> tuple[bool, ...]:
        """For each frame of the window, whether its labels are swapped."""
        if self.histories is None:
            return ()
        return min(self.histories, key=lambda h: h.cost).swapped


def swapped_frames(times: Array, points: Array, weight: Array, mirror: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(F,) whether left and right are swapped; times (F,) s, points (F, J, 2), weight (F, J) of a sequence."""
    chain = SwapFilter(mirror)
    out = np.zeros(len(times), bool)
    seen = np.flatnonzero((weight > 0).sum(axis=1) > 1)
    for frame in seen:
        _, size = extent(points[frame], weight[frame])
        chain = chain.update(float(times[frame]), points[frame], weight[frame], size)
    out[seen] = chain.verdict
    return out
