# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The image noise of a fit: its residual, shared among the coordinates that the unknowns have not absorbed.

    noise^2 = sum_tj w_tj rho(|e_tj|^2) / (2 S - m),    m = F / |T| sum_(t in T) m_t

over the frames t and the S seen joints of a sequence (`reprojection`). m_t counts the coordinates of frame t that
the unknowns fit away while the neighbours of the frame are held
(`normal_equations.NormalEquations.count_absorbed_coordinates`). It is counted in some free frames T, and
extrapolated to all F frames.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import BOOLS_1D, FLOATS_1D, FLOATS_2D, INTS_1D, kernel
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.reprojection import Reprojection
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MIN_FREE_SHARE = 0.05  # of the coordinates; where the unknowns fit nearly all of them, so many still measure
COUNTED_FRAMES = 3  # frames of a sequence, at least, in which the unknowns that the fit absorbs are counted
COUNTED_FRAME_STEP = 15  # frames; of a longer sequence one further frame in so many is counted


def estimate_noise(
    reprojection: Reprojection, batch: Batch, is_free: NDArray[np.bool_], fit: Fit, equations: NormalEquations
) -> Array:
    """Return the standard deviation (P,) m of a coordinate of an image point with score 1 in each sequence.

    Args:
        reprojection: the term of the image points.
        batch: which frames belong to which sequence.
        is_free: (N,) False for frames that keep their initial values.
        fit: of the state at hand.
        equations: of that state or of one nearby.
    """
    frames = choose_counted_frames(batch.starts, batch.counts, is_free)
    return _share_residual(
        batch.starts,
        batch.counts,
        reprojection.weight,
        reprojection.variance_ratio,
        reprojection.cost(fit),
        frames,
        equations.count_absorbed_coordinates(frames),
    )


@kernel(INTS_1D(INTS_1D, INTS_1D, BOOLS_1D))
def choose_counted_frames(starts: Ints, counts: Ints, is_free: NDArray[np.bool_]) -> Ints:
    """Return the frames in which the unknowns are counted, those of all sequences one after the other.

    Args:
        starts: (P,) first frame of each sequence.
        counts: (P,) number of frames of each sequence.
        is_free: (N,) False for frames that keep their initial values, the first ones of a sequence if any.
    """
    frames = np.empty(np.sum(counts), np.int64)
    size = 0
    for p in range(len(starts)):
        first, end = starts[p], starts[p] + counts[p]
        while first < end and not is_free[first]:
            first += 1
        most = COUNTED_FRAMES + (end - first) // COUNTED_FRAME_STEP
        stride = max(-(-(end - first) // most), 1)
        for t in range(first, end, stride):
            frames[size] = t
            size += 1
    return frames[:size]


@kernel(FLOATS_1D(INTS_1D, INTS_1D, FLOATS_2D, FLOATS_1D, FLOATS_1D, INTS_1D, FLOATS_1D))
def _share_residual(
    starts: Ints,
    counts: Ints,
    weight: Array,
    variance_ratio: Array,
    cost: Array,
    frames: Ints,
    absorbed: Array,
) -> Array:
    """Return the noise (P,) of each sequence.

    Args:
        starts: (P,) first frame of each sequence.
        counts: (P,) number of frames of each sequence.
        weight: (N, J) scores, 0 where a joint is not seen.
        variance_ratio: (N,) by which the cost was divided.
        cost: (N,) m^2, of the reprojection.
        frames: (M,) frames in which the unknowns were counted.
        absorbed: (M,) numbers m_t of these frames.
    """
    noise = np.empty(len(starts))
    index = 0
    for p in range(len(starts)):
        end = starts[p] + counts[p]
        squares, coordinates = 0.0, 0
        for t in range(starts[p], end):
            squares += variance_ratio[t] * cost[t]
            for j in range(weight.shape[1]):
                if weight[t, j] > 0:
                    coordinates += 2
        total, counted = 0.0, 0
        while index < len(frames) and frames[index] < end:
            total += absorbed[index]
            counted += 1
            index += 1
        free = coordinates - total * counts[p] / max(counted, 1)
        noise[p] = np.sqrt(squares / max(free, MIN_FREE_SHARE * coordinates + 1))
    return noise
