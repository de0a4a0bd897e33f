"""Outliers as discontinuities of the 3D motion (Loy et al. 2004, section 7).

Image points are lifted to the depths of the interpolated motion. A point in its right place stays near the place
that motion expects it in, and near its own last right place; one that is wrong jumps away and back. For each
joint the most likely set of right frames is found exactly by dynamic programming over pairs of successive right
frames.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.filters import median, running_median

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LONGEST = 0.7
STILL, SPEED = 0.03, 3.0
LEAST_SPREAD, SPREADS = 0.1, 3.0
WRONG = 9.0
MOST_FRAMES = 61


def outliers(displacement: Array, seen: Mask, times: Array) -> Mask:
    """(F, J) points that are wrong.

    Args:
        displacement: (F, J, 2) m, of lifted points from where the interpolated motion has them.
        seen: (F, J).
        times: (F,) s, increasing.
    """
    frames, joints = seen.shape
    magnitude = np.linalg.norm(displacement, axis=-1)
    usual = np.nan_to_num(median(np.where(seen, magnitude, np.nan), axis=0))
    spread = np.maximum(SPREADS * usual, LEAST_SPREAD)
    alone = np.where(seen, np.minimum((magnitude / spread) ** 2, 2 * WRONG), np.inf)
    # passed[t]: cost of calling every seen point up to and including t wrong
    passed = np.cumsum(np.where(seen, WRONG, 0.0), axis=0)
    best = np.full((frames, joints), np.inf)
    origin = np.full((frames, joints), -1)
    # the cheapest last right point so far, however long ago, less the cost of calling all up to it wrong
    ago, ago_at = np.full(joints, np.inf), np.full(joints, -1)
    first = np.maximum(np.searchsorted(times, times - LONGEST), np.arange(frames) - MOST_FRAMES)
    for t in range(frames):
        before = passed[t - 1] if t else np.zeros(joints)
        fresh = ago + before + WRONG
        cost, source = np.where(fresh < before, fresh, before), np.where(fresh < before, ago_at, -1)
        a = int(first[t])
        if a < t:
            dt = (times[t] - times[a:t])[:, None]
            jump = ((displacement[t] - displacement[a:t]) ** 2).sum(axis=-1) / (STILL**2 + (SPEED * dt) ** 2)
            way = best[a:t] + jump + before - passed[a:t]
            near = way.argmin(axis=0)
            least = way[near, np.arange(joints)]
            cost, source = np.where(least < cost, least, cost), np.where(least < cost, near + a, source)
        best[t], origin[t] = cost + alone[t], source
        newer = best[t] - passed[t] < ago
        ago, ago_at = np.where(newer, best[t] - passed[t], ago), np.where(newer, t, ago_at)
    return _traced(best, origin, passed, seen)


def jumps(points: Array, seen: Mask, times: Array) -> Mask:
    """(F, J) points that jump away from where they mostly are within `LONGEST` s: a first look, without 3D.

    Args:
        points: (F, J, 2) m, about, at the depth of the body.
        seen: (F, J).
        times: (F,) s, increasing.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else LONGEST
    reach = min(max(round(LONGEST / step / 2), 1), MOST_FRAMES // 2)
    away = np.nan_to_num(points - running_median(np.where(seen[..., None], points, np.nan), reach))
    return outliers(away, seen, times)


def _traced(best: Array, origin: Array, passed: Array, seen: Mask) -> Mask:
    right = np.zeros(seen.shape, bool)
    end = best + passed[-1] - passed
    for j in range(seen.shape[1]):
        t = int(end[:, j].argmin())
        if end[t, j] >= passed[-1, j]:
            continue
        while t >= 0:
            right[t, j] = True
            t = int(origin[t, j])
    return np.asarray(seen & ~right)
