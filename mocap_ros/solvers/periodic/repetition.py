# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How well the newest part of a motion repeats what was one cycle before.

With theta(t) the base-pose weights at a time, n the newest 0.4 s, and c these and the cycle before them,

    r = 1 - min_T mean_n |theta(t) - theta(t - T)|^2 / (2 mean_c |theta(t) - mean_c theta|^2)

where T is any length near that of the cycle. This is a coefficient of correlation: 1 if the motion repeats itself,
0 if the newest poses have nothing to do with those before, as after a walk has ended in a jump.

The largest r over all cadences says cheaply that a motion cannot be periodic.
"""

from __future__ import annotations

import math

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.geometry.interpolation import interpolate_linearly
from mocap_ros.solvers.periodic.fourier import MAX_CADENCE_HZ, MIN_CADENCE_HZ, MIN_CYCLES

NEWEST_S = 0.4  # s; most of a step of a walk: half of it shows that something else has begun
SAMPLE_STEP_S = 1 / 15  # s; at which a motion is compared, often enough for a run
MAX_STRETCH = 0.1  # of the cycle; by so much two cycles of a person differ, and a cadence is wrong
STRETCHES = 9  # lengths of a cycle that are tried
EPSILON = 1e-9  # of the longest cycle that is known; keeps rounding from making it longer
# of the longest cycle that may be fitted; motion that is known for less than that may repeat itself later
MIN_SHARE_OF_CYCLE = 0.75


def measure_repetition(times: Array, theta: Array, cadence: float) -> float:
    """Return r (formula of the module); NaN if the motion is not known for long enough or does not move.

    `times` (F,) s, increasing; `theta` (F, K) m, base-pose weights at these times; `cadence` Hz, full cycles.
    """
    known_s = times[-1] - times[0] - NEWEST_S
    if known_s * cadence < 1:
        return math.nan
    longest_s = min((1 + MAX_STRETCH) / cadence, known_s)
    cycles_s = np.linspace((1 - MAX_STRETCH) / cadence, longest_s, STRETCHES)
    ages_s = np.arange(0, NEWEST_S + 1 / cadence, SAMPLE_STEP_S)
    newest = int(ages_s.searchsorted(NEWEST_S, side='right'))
    before_s = ages_s[:newest] + cycles_s[:, None]
    poses = interpolate_linearly(times[-1] - np.concatenate([ages_s, before_s.ravel()]), times, theta)
    poses, before = poses[: len(ages_s)], poses[len(ages_s) :].reshape(STRETCHES, newest, -1)
    moved, changes = poses - poses.mean(axis=0), poses[:newest] - before
    spread = np.vdot(moved, moved) / len(poses)
    change = np.einsum('sik,sik->s', changes, changes).min() / newest
    return float(1 - change / (2 * spread)) if spread > 0 else math.nan


def measure_best_repetition(times: Array, theta: Array) -> float:
    """Return the largest r over all cadences; NaN if the motion is known for too short a time.

    `times` (F,) s, increasing; `theta` (F, K) m, base-pose weights at these times.
    """
    span_s = times[-1] - times[0]
    longest_s = span_s - NEWEST_S
    if longest_s < MIN_SHARE_OF_CYCLE / max(MIN_CADENCE_HZ, MIN_CYCLES / max(span_s, NEWEST_S)):
        return math.nan
    # the lengths of cycles that `measure_repetition` tries for one cadence end where those of the next begin
    step = (1 + MAX_STRETCH) / (1 - MAX_STRETCH)
    count = math.ceil(math.log(longest_s * MAX_CADENCE_HZ, step))
    cycles_s = [*(step**i / MAX_CADENCE_HZ for i in range(count)), longest_s * (1 - EPSILON)]
    return float(np.fmax.reduce([measure_repetition(times, theta, 1 / cycle_s) for cycle_s in cycles_s]))
