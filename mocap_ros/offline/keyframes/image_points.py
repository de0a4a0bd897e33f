# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Image points over time: filters, and outliers as discontinuities of the 3D motion (Loy et al. 2004, section 7).

For each joint, the set S of inlier frames that minimises

    E(S) = sum_{t in S} (|d_t| / s)^2 + c |not S|
         + sum_{a, b successive in S} |d_b - d_a|^2 / (n^2 + (v (time_b - time_a))^2)

is found by dynamic programming. d_t is the displacement (m) of the back-projected point from the interpolated
motion, s (m) the joint's spread, n = `POINT_NOISE_M`, v = `MAX_SPEED` and c = `OUTLIER_COST`. Terms of the first
sum are at most 2 c, those of the last c, as for inliers more than `MAX_LINK_S` apart, or 0 if the joint was not
seen in between.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mocap_ros.arrays import Array, Mask

if TYPE_CHECKING:
    from scipy.sparse import csr_array

FILTER_REACH = 3.5  # standard deviations; frames further away would weigh less than 0.3 % of the frame itself
MIN_SECONDS = 1e-9  # s; guards divisions by a width or a time difference of zero


def build_low_pass_matrix(times: Array, width: float) -> csr_array:
    """L(i, j) = g(t_i - t_j) / sum_k g(t_i - t_k), g(t) = exp(-t^2 / (2 width^2)): a low-pass filter (F, F)."""
    from scipy.sparse import csr_array

    frames = len(times)
    first = np.searchsorted(times, times - FILTER_REACH * width)
    last = np.searchsorted(times, times + FILTER_REACH * width, side='right')
    count = last - first
    row = np.repeat(np.arange(frames), count)
    row_start = np.concatenate([[0], np.cumsum(count)])
    column = np.arange(row_start[-1]) - row_start[row] + first[row]
    weight = np.exp(-0.5 * ((times[row] - times[column]) / max(width, MIN_SECONDS)) ** 2)
    total = np.bincount(row, weight, minlength=frames)
    return csr_array((weight / total[row], column, row_start), shape=(frames, frames))


def running_median(values: Array, reach: int) -> Array:
    """Return the medians (F, ...) over `reach` frames before and after each of the values that are not NaN."""
    edge = np.full((reach, *values.shape[1:]), np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([edge, values, edge]), 2 * reach + 1, axis=0)
    return nan_median(windows, axis=-1)


def nan_median(values: Array, axis: int) -> Array:
    """Return the median along an axis of the values that are not NaN, or NaN where all are."""
    ranked = np.sort(values, axis=axis)
    count = np.isfinite(values).sum(axis=axis, keepdims=True)
    lower = np.take_along_axis(ranked, np.maximum((count - 1) // 2, 0), axis)
    upper = np.take_along_axis(ranked, np.minimum(count // 2, values.shape[axis] - 1), axis)
    return np.asarray(np.squeeze((lower + upper) / 2, axis=axis))


def interpolate_gaps(points: Array, seen: Mask, times: Array, max_gap: float) -> tuple[Array, Mask]:
    """Interpolate points (F, J, D) through gaps of at most `max_gap` s; return also which are then known."""
    out, known = points.copy(), seen.copy()
    for j in range(points.shape[1]):
        seen_frames = np.flatnonzero(seen[:, j])
        if len(seen_frames) in (0, len(times)):
            continue
        after = np.searchsorted(seen_frames, np.arange(len(times))).clip(1, max(len(seen_frames) - 1, 1))
        before, after = seen_frames[after - 1], seen_frames[np.minimum(after, len(seen_frames) - 1)]
        t0, t1 = times[before], times[after]
        inside = ~seen[:, j] & (t0 < times) & (times < t1) & (t1 - t0 <= max_gap)
        share = ((times - t0) / np.maximum(t1 - t0, MIN_SECONDS))[inside, None]
        out[inside, j] = (1 - share) * points[before[inside], j] + share * points[after[inside], j]
        known[inside, j] = True
    return out, known


# the costs and spreads below were tuned on CMU motion capture with injected outliers
MAX_LINK_S = 0.7  # s; two inliers further apart are not compared
POINT_NOISE_M = 0.03  # m, n: noise of a correct point's displacement, without motion
MAX_SPEED = 3.0  # m/s, v: speed of a correct point relative to the interpolated motion
MIN_SPREAD_M = 0.1  # m, least s: a joint that hardly leaves the motion must not make small displacements outliers
SPREAD_FACTOR = 3.0  # s divided by the joint's median displacement
OUTLIER_COST = 9.0  # c: cost of an outlier, that of three standard deviations
MAX_LINK_FRAMES = 61  # frames; bounds the work a frame at high frame rates


def find_outliers(displacement: Array, seen: Mask, times: Array) -> Mask:
    """Find the image points (F, J) that make the 3D motion discontinuous.

    `displacement` (F, J, 2) m along the image axes, the image points, back-projected to the depths of their
    joints, minus the joints of the interpolated motion, arbitrary but finite where a point is not seen; `seen` (F,
    J) True where a point is seen; `times` (F,) s, increasing.
    """
    frames, joints = seen.shape
    magnitude = np.linalg.norm(displacement, axis=-1)
    median_magnitude = np.nan_to_num(nan_median(np.where(seen, magnitude, np.nan), axis=0))
    spread = np.maximum(SPREAD_FACTOR * median_magnitude, MIN_SPREAD_M)
    own_cost = np.where(seen, np.minimum((magnitude / spread) ** 2, 2 * OUTLIER_COST), np.inf)
    # skipped[t]: cost if every seen point up to and including t is an outlier
    skipped = np.cumsum(np.where(seen, OUTLIER_COST, 0.0), axis=0)
    best = np.full((frames, joints), np.inf)  # least cost up to t if t is an inlier
    previous = np.full((frames, joints), -1)  # the inlier before t at that cost
    # the cheapest inlier so far, however long ago, relative to the cost if all points up to it are outliers
    unlinked_cost, unlinked_frame = np.full(joints, np.inf), np.full(joints, -1)
    # seen_before[t]: number of frames before t in which the joint is seen
    seen_before = np.concatenate([np.zeros((1, joints), int), np.cumsum(seen, axis=0)])
    first_link = np.maximum(np.searchsorted(times, times - MAX_LINK_S), np.arange(frames) - MAX_LINK_FRAMES)
    for t in range(frames):
        skipped_before = skipped[t - 1] if t else np.zeros(joints)
        was_seen = seen_before[t] > seen_before[first_link[t]]  # so recently that it could have been compared
        restart = unlinked_cost + skipped_before + np.where(was_seen, OUTLIER_COST, 0.0)
        cost = np.where(restart < skipped_before, restart, skipped_before)
        source = np.where(restart < skipped_before, unlinked_frame, -1)
        a = int(first_link[t])
        if a < t:
            dt = (times[t] - times[a:t])[:, None]
            moved = ((displacement[t] - displacement[a:t]) ** 2).sum(axis=-1)
            jump = moved / (POINT_NOISE_M**2 + (MAX_SPEED * dt) ** 2)
            linked = best[a:t] + jump + skipped_before - skipped[a:t]
            nearest = linked.argmin(axis=0)
            least = linked[nearest, np.arange(joints)]
            cost, source = np.where(least < cost, least, cost), np.where(least < cost, nearest + a, source)
        best[t], previous[t] = cost + own_cost[t], source
        is_cheaper = best[t] - skipped[t] < unlinked_cost
        unlinked_cost = np.where(is_cheaper, best[t] - skipped[t], unlinked_cost)
        unlinked_frame = np.where(is_cheaper, t, unlinked_frame)
    return np.asarray(seen & ~_trace_inliers(best, previous, skipped))


def _trace_inliers(best: Array, previous: Array, skipped: Array) -> Mask:
    inliers = np.zeros(best.shape, bool)
    total = best + skipped[-1] - skipped
    for j in range(best.shape[1]):
        t = int(total[:, j].argmin())
        if total[t, j] >= skipped[-1, j]:
            continue
        while t >= 0:
            inliers[t, j] = True
            t = int(previous[t, j])
    return inliers


def find_jumping_points(points: Array, seen: Mask, times: Array) -> Mask:
    """Find the image points (F, J) that jump away from their running median, before a 3D motion exists.

    The points (F, J, 2) in m are back-projected to about the body's depth.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else MAX_LINK_S
    reach = min(max(round(MAX_LINK_S / step / 2), 1), MAX_LINK_FRAMES // 2)
    displacement = np.nan_to_num(points - running_median(np.where(seen[..., None], points, np.nan), reach))
    return find_outliers(displacement, seen, times)
