"""Greedy choice of keyframes (Loy et al. 2004, section 4.3, eq. 1 to 4), in seconds instead of frames.

Frame f is well represented by keyframe k where D(k, f) < beta, and always by itself. For a set W of well
represented frames eq. 2 is

    C = sum_i ( min_{f in W, f < i} |t_i - t_f| + min_{f in W, f > i} |t_i - t_f| )

Convention where no frame of W is on one side of i: one interval before the first frame and one after the last
count as well represented. Between two neighbours in W, T_ab apart with g frames between them, all terms together
are (g + 2) T_ab, so eq. 2 is a sum over gaps, and a keyframe changes only the gaps it reaches into: that is what
makes the incremental choice fast and equal to the direct one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

LONE_FRAME = 1 / 30


def interval(times: Array) -> float:
    """s, the usual one between frames."""
    return float(np.median(np.diff(times))) if len(times) > 1 else LONE_FRAME


def mean_gap_cost(well: Mask, times: Array) -> float:
    """Eq. 2 as it stands, s; `well` (N,) the well-represented frames, times (N,) s."""
    step = interval(times)
    total = 0.0
    for i, t in enumerate(times):
        left = times[:i][well[:i]]
        right = times[i + 1 :][well[i + 1 :]]
        total += t - (left[-1] if len(left) else times[0] - step)
        total += (right[0] if len(right) else times[-1] + step) - t
    return float(total)


def interpolatable(well: Mask, times: Array, gap: float) -> Mask:
    """(N,) J: frames between two well-represented ones less than `gap` s apart, themselves not in W."""
    at = np.flatnonzero(well)
    out = np.zeros(len(well), bool)
    if len(at) > 1:
        right = np.searchsorted(at, np.arange(len(well)))
        inside = ~well & (right > 0) & (right < len(at))
        right = right[inside]
        out[inside] = times[at[right]] - times[at[right - 1]] < gap
    return out


@dataclass(frozen=True, eq=False)
class Selection:
    """Keyframes in the order in which they were chosen, over N frames.

    Attributes:
        keyframes: (K,) indices.
        well: (N,) frames that one of them represents well: W.
        covered: (N,) W and the frames that can be interpolated: W u J.
        coverage: (K,) share of covered frames with that keyframe and those before it.
    """

    keyframes: Indices
    well: Mask
    covered: Mask
    coverage: Array


def select(
    represents: Mask,
    times: Array,
    alpha: float,
    gap: float,
    well: Mask | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Selection:
    """The keyframes, by eq. 3 and 4 until eq. 1 holds.

    Args:
        represents: (N, N) row k: the frames that k represents well, D(k, .) < beta.
        times: (N,) s, increasing.
        alpha: share of the frames to cover.
        gap: T, s.
        well: (N,) frames represented well already, by keyframes from elsewhere.
        progress: told the share of covered frames.

    Returns:
        The selection; of equal candidates the earliest frame is chosen.
    """
    represents = represents | np.eye(len(times), dtype=bool)
    gaps = _Gaps(represents, times, np.zeros(len(times), bool) if well is None else well.copy())
    chosen: list[int] = []
    coverage: list[float] = []
    covered = gaps.well | interpolatable(gaps.well, times, gap)
    while covered.sum() < alpha * len(times) and len(chosen) < len(times):
        best = gaps.best()
        gaps.add(best)
        chosen.append(best)
        covered = gaps.well | interpolatable(gaps.well, times, gap)
        coverage.append(float(covered.mean()))
        progress(coverage[-1])
    return Selection(np.array(chosen, int), gaps.well, covered, np.array(coverage))


@dataclass(eq=False)
class _Gaps:
    """Eq. 2 of W with each candidate added, kept up to date: the sum over the gaps of W."""

    represents: Mask
    times: Array
    well: Mask
    cost: Array = field(init=False)
    taken: Mask = field(init=False)

    def __post_init__(self) -> None:
        step = interval(self.times)
        self.padded = np.concatenate([[self.times[0] - step], self.times, [self.times[-1] + step]])
        self.cost = np.zeros(len(self.times))
        self.taken = np.zeros(len(self.times), bool)
        for first, last in self._borders(-1, len(self.times)):
            self.cost += self._within(first, last)

    def _borders(self, first: int, last: int) -> list[tuple[int, int]]:
        """Neighbours in W from `first` to `last`, which count as members; -1 and N are the ends."""
        inside = np.flatnonzero(self.well[max(first + 1, 0) : last]) + first + 1
        at = [first, *inside.tolist(), last]
        return list(pairwise(at))

    def _within(self, first: int, last: int) -> Array:
        """(N,) terms of eq. 2 of the gap between two members of W, for each candidate added to W."""
        block = self.represents[:, first + 1 : last]
        row, frame = np.nonzero(block)
        frame = frame + first + 1
        heads = np.searchsorted(row, np.arange(len(block)))
        filled = np.diff(heads, append=len(row)) > 0
        # from each represented frame to the next one of its candidate, or to the end of the gap
        following = np.append(frame[1:], last)
        following[heads[filled][1:] - 1] = last
        following[-1:] = last
        terms = np.bincount(row, self._pair(frame, following), minlength=len(block))
        start = np.full(len(block), last)
        start[filled] = frame[heads[filled]]
        return np.asarray(terms + self._pair(np.full(len(block), first), start))

    def _pair(self, a: Indices, b: Indices) -> Array:
        """All terms of eq. 2 between neighbours a < b of W; the ends have no terms of their own."""
        own = (a >= 0).astype(int) + (b < len(self.times))
        return np.asarray((b - a - 1 + own) * (self.padded[b + 1] - self.padded[a + 1]))

    def best(self) -> int:
        """The candidate with the least cost, the earliest of those that differ by rounding only."""
        cost = np.where(self.taken, np.inf, self.cost)
        least = cost.min()
        return int(np.argmax(cost <= least + 1e-9 * max(abs(least), 1.0)))

    def add(self, keyframe: int) -> None:
        """Take a keyframe: only gaps that it reaches into change."""
        new = np.flatnonzero(self.represents[keyframe] & ~self.well)
        members = np.concatenate([[-1], np.flatnonzero(self.well), [len(self.well)]])
        reached = np.unique(np.searchsorted(members, new))
        self.well = self.well | self.represents[keyframe]
        self.taken[keyframe] = True
        for right in reached.tolist():
            first, last = int(members[right - 1]), int(members[right])
            self.cost -= self._within(first, last)
            for a, b in self._borders(first, last):
                self.cost += self._within(a, b)
