"""Filters over time for frames at any rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH = 3.5
SMALLEST = 1e-9


def low_pass(times: Array, width: float) -> csr_array:
    """(F, F) matrix that takes Gaussian means over time, sparse; `width` s, standard deviation."""
    frames = len(times)
    first = np.searchsorted(times, times - REACH * width)
    last = np.searchsorted(times, times + REACH * width, side='right')
    count = last - first
    row = np.repeat(np.arange(frames), count)
    start = np.concatenate([[0], np.cumsum(count)])
    column = np.arange(start[-1]) - start[row] + first[row]
    weight = np.exp(-0.5 * ((times[row] - times[column]) / max(width, SMALLEST)) ** 2)
    total = np.bincount(row, weight, minlength=frames)
    return csr_array((weight / total[row], column, start), shape=(frames, frames))


def running_median(values: Array, reach: int) -> Array:
    """(F, ...) median over so many frames before and after each, of those that are not NaN."""
    edge = np.full((reach, *values.shape[1:]), np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([edge, values, edge]), 2 * reach + 1, axis=0)
    return median(windows, axis=-1)


def median(values: Array, axis: int) -> Array:
    """Median of what is not NaN along an axis, NaN where nothing is."""
    ranked = np.sort(values, axis=axis)
    count = np.isfinite(values).sum(axis=axis, keepdims=True)
    lower = np.take_along_axis(ranked, np.maximum((count - 1) // 2, 0), axis)
    upper = np.take_along_axis(ranked, np.minimum(count // 2, values.shape[axis] - 1), axis)
    return np.asarray(np.squeeze((lower + upper) / 2, axis=axis))


def bridged(points: Array, seen: Mask, times: Array, longest: float) -> tuple[Array, Mask]:
    """Points with short gaps interpolated.

    Args:
        points: (F, J, D), anything where not seen.
        seen: (F, J).
        times: (F,) s, increasing.
        longest: s between the frames before and after a gap, at most.

    Returns:
        (F, J, D) points and (F, J) where they are known now.
    """
    out, known = points.copy(), seen.copy()
    for j in range(points.shape[1]):
        at = np.flatnonzero(seen[:, j])
        if len(at) in (0, len(times)):
            continue
        after = np.minimum(np.searchsorted(at, np.arange(len(times))), len(at) - 1)
        before = np.maximum(np.searchsorted(at, np.arange(len(times)), side='right') - 1, 0)
        t0, t1 = times[at[before]], times[at[after]]
        inside = ~seen[:, j] & (t0 < times) & (times < t1) & (t1 - t0 <= longest)
        share = ((times - t0) / np.maximum(t1 - t0, SMALLEST))[inside, None]
        out[inside, j] = (1 - share) * points[at[before][inside], j] + share * points[at[after][inside], j]
        known[inside, j] = True
    return out, known
