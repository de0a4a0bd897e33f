# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Linear interpolation of vectors over time, and the nearest of some times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def find_nearest(times: Array, known: Array) -> NDArray[np.intp]:
    """Return for each of some times (N,) the index of the nearest of others (n,), n >= 1, increasing.

    Of two that are equally near it is the earlier one.
    """
    after = np.minimum(np.searchsorted(known, times), len(known) - 1)
    before = np.maximum(after - 1, 0)
    is_after_nearer = np.abs(times - known[after]) < np.abs(times - known[before])
    return np.where(is_after_nearer, after, before)


def interpolate_linearly(times: Array, sample_times: Array, samples: Array) -> Array:
    """Return samples (N, D) interpolated at other times; the first and the last one hold beyond the ends.

    Args:
        times: (N,) times.
        sample_times: (n,) times of the samples, increasing.
        samples: (n, D) values.
    """
    if len(sample_times) == 1:
        return np.repeat(samples, len(times), axis=0)
    right = np.clip(np.searchsorted(sample_times, times), 1, len(sample_times) - 1)
    left = right - 1
    share = np.clip((times - sample_times[left]) / (sample_times[right] - sample_times[left]), 0, 1)[:, None]
    return np.asarray((1 - share) * samples[left] + share * samples[right])
