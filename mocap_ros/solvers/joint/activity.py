# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How fast a motion is, by which the limit to accelerations gives way (`engine.terms.Acceleration`).

The mean square acceleration of poses or cameras within `ACTIVITY_SPAN_S` of a frame, in some frames:

    a_t^2 = mean_u |v_(u+1) - v_u|^2 / h_u^2,    v_u = (x_(u+1) - x_u) / dt_u,    h_u = (dt_u + dt_(u+1)) / 2
"""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import batch as engine
from mocap_ros.solvers.joint.batch import Batch, State

ACTIVITY_SPAN_S = 0.5  # s; a step of a run takes 0.35 s, and a motion that begins or ends should show soon


def measure_activity(values: Array, coarse: Batch, batch: Batch) -> Array:
    """Return the mean square acceleration about each frame of a batch, (N,), of values (M, D) in some frames."""
    out = np.empty(len(batch.times))
    for some, every in zip(coarse.slices, batch.slices, strict=True):
        times, squares = coarse.times[some], np.zeros(len(coarse.times[some]))
        steps = np.maximum(np.diff(times), engine.MIN_TIME_STEP_S)
        change = np.diff(np.diff(values[some], axis=0) / steps[:, None], axis=0)
        squares[1:-1] = (change**2).sum(axis=1) / ((steps[1:] + steps[:-1]) / 2) ** 2
        sums = np.concatenate([[0.0], np.cumsum(squares)])
        first = np.searchsorted(times, batch.times[every] - ACTIVITY_SPAN_S)
        end = np.searchsorted(times, batch.times[every] + ACTIVITY_SPAN_S, side='right')
        out[every] = (sums[end] - sums[first]) / np.maximum(end - first, 1)
    return out


def measure_activities(state: State, coarse: Batch, batch: Batch) -> tuple[Array, Array]:
    """Return the mean square accelerations (N,) of poses and cameras about each frame, from a state of some."""
    directions = state.rotation[:, :2].reshape(len(state.theta), 6)
    return measure_activity(state.theta, coarse, batch), measure_activity(directions, coarse, batch)
