"""Left and right swapped by the detector: recognised by how limbs move, and undone.

A hidden Markov chain with two states, labels right or swapped, decoded by Viterbi's algorithm. Each of the two
histories that survive carries the image points as it has relabelled them and predicts the next from their motion;
a frame's cost is how far its points, under either labelling, are from that prediction. So a later frame may change
the verdict on earlier ones, as far back as the window reaches.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.keypoints.association import extent

Array = NDArray[np.float64]

ENTER, LEAVE = 0.01, 0.15
FIRST_SWAPPED = 3.0
SPREAD, SPREAD_PER_S, SPREAD_PER_S2 = 0.05, 1.0, 5.0
MOST_COST = 9.0
VELOCITY_TIME = 0.06
LONGEST_STEP = 0.2
FRAME_TIME = 1 / 30


@dataclass(frozen=True, eq=False)
class Histories:
    """The two surviving histories: that whose newest labels are right, and that whose newest are swapped.

    Attributes:
        cost: (2,) minus their log likelihood, up to a constant.
        swapped: (2, F) verdict on each frame of the window.
        points: (2, J, 2) last relabelled ones; velocity: (2, J, 2) per s; seen: (2, J) s of the last sight.
    """

    cost: Array
    swapped: NDArray[np.bool_]
    points: Array
    velocity: Array
    seen: Array

    @staticmethod
    def begun(time: float, points: Array, seen: NDArray[np.bool_]) -> Histories:
        """By a first frame under both labellings (2, J, 2), (2, J)."""
        return Histories(
            np.array([0.0, FIRST_SWAPPED]),
            np.array([[False], [True]]),
            points,
            np.zeros_like(points),
            np.where(seen, time, -np.inf),
        )

    def surprise(self, time: float, points: Array, seen: NDArray[np.bool_], size: float) -> Array:
        """(2, 2) of each history (rows) at the next frame under each labelling (columns): minus log likelihood.

        Args:
            time: s.
            points: (2, J, 2) under both labellings, of the joints that have a counterpart.
            seen: (2, J).
            size: of the body, in the units of the points.
        """
        known = np.isfinite(self.seen)
        age = time - np.where(known, self.seen, time)
        ahead = VELOCITY_TIME * (1 - np.exp(-age / VELOCITY_TIME)) * 2
        expected = self.points + self.velocity * ahead[..., None]
        spread = SPREAD + SPREAD_PER_S * age + SPREAD_PER_S2 * age**2
        apart = points - expected[:, None]
        squared = np.einsum('hljd,hljd->hlj', apart, apart) / (size * spread[:, None]) ** 2
        cost = MOST_COST * np.log1p((0.5 / MOST_COST) * squared) + 2 * np.log(spread)[:, None]
        return np.asarray((cost * (seen & known[:, None])).sum(axis=-1))

    def then(
        self, time: float, points: Array, seen: NDArray[np.bool_], cost: Array, before: NDArray[np.intp]
    ) -> Histories:
        """Gone on with a frame: the labellings (2, ...), each after the history `before` (2,) at a `cost` (2,)."""
        last, velocity, sight = self.points[before], self.velocity[before], self.seen[before]
        age = np.maximum(time - sight, 1e-3)
        blend = 1 - np.exp(-age / VELOCITY_TIME)
        fresh = (points - last) / age[..., None]
        moving = np.where((age < LONGEST_STEP)[..., None], velocity + blend[..., None] * (fresh - velocity), 0.0)
        take = seen[..., None]
        return Histories(
            cost - cost.min(),
            np.concatenate([self.swapped[before], [[False], [True]]], axis=1),
            np.where(take, points, last),
            np.where(take, moving, velocity),
            np.where(seen, time, sight),
        )


@dataclass(frozen=True, eq=False)
class SwapFilter:
    """Recognises swapped labels of one person.

    Attributes:
        mirror: (J,) index of each joint's counterpart.
        enabled: False to believe the detector.
        verdict: (F,) for each frame of the window, whether its labels are swapped.
    """

    mirror: NDArray[np.intp]
    enabled: bool = True
    verdict: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    histories: Histories | None = None

    def update(self, time: float, points: Array, weight: Array, size: float) -> SwapFilter:
        """With one frame more.

        Args:
            time: s.
            points: (J, 2) as the detector labelled them.
            weight: (J,), 0 where not seen.
            size: of the body in the units of the points.
        """
        if not self.enabled:
            return replace(self, verdict=np.append(self.verdict, False))
        both = np.stack([points, points[self.mirror]])
        seen = np.stack([weight, weight[self.mirror]]) > 0
        old = self.histories
        if old is None:
            new = Histories.begun(time, both, seen)
        else:
            steps = max(time - float(old.seen[0].max()), 1e-3) / FRAME_TIME
            mixed = (1 - (1 - ENTER - LEAVE) ** steps) / (ENTER + LEAVE)
            enter, leave = ENTER * mixed, LEAVE * mixed
            change = -np.log([[1 - enter, enter], [leave, 1 - leave]])
            sided = self.mirror != np.arange(len(self.mirror))
            ways = old.cost[:, None] + old.surprise(time, both, seen & sided, size) + change
            before = ways.argmin(axis=0)
            new = old.then(time, both, seen, ways[before, [0, 1]], before)
        return replace(self, histories=new, verdict=new.swapped[new.cost.argmin()])

    def forgot(self, frames: int) -> SwapFilter:
        """Without the verdicts on the oldest frames."""
        if frames == 0:
            return self
        old = self.histories
        if old is not None:
            old = replace(old, swapped=old.swapped[:, frames:])
        return replace(self, histories=old, verdict=self.verdict[frames:])


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
