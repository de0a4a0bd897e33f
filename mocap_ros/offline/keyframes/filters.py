# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Low-pass filter, medians and gap interpolation over time, for frames at any rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FILTER_REACH = 3.5  # standard deviations; frames further away would weigh less than 0.3 % of the frame itself
MIN_SECONDS = 1e-9  # s; guards divisions by a width or a time difference of zero


def build_low_pass_matrix(times: Array, width: float) -> csr_array:
    """L(i, j) = g(t_i - t_j) / sum_k g(t_i - t_k), g(t) = exp(-t^2 / (2 width^2)): a Gaussian low-pass filter.

    Args:
        times: (F,) s, increasing.
        width: s, standard deviation of the Gaussian.

    Returns:
        (F, F) sparse matrix; its product with (F, D) values is the filtered values.
    """
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
    """Interpolate each point linearly through the short gaps in which it is not seen.

    Args:
        points: (F, J, D) any unit, arbitrary where not seen.
        seen: (F, J) True where a point is seen.
        times: (F,) s, increasing.
        max_gap: s, largest time between the frames before and after a gap that is interpolated.

    Returns:
        (F, J, D) points, and (F, J) True where a point is seen or interpolated.
    """
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
