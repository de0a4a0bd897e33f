# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A limit to accelerations that gives way to motion that is truly fast.

Both terms of acceleration (`pose_acceleration`, `camera_acceleration`) have the form

    sum_t alpha_t |v_(t+1) - v_t|^2 / h_t,    v_t = (x_(t+1) - x_t) / dt_t,    h_t = (dt_t + dt_(t+1)) / 2
    alpha_t = alpha / (1 + a_t^4 / (A min(r, R))^4)

of some values x_t, with dt_t the time from frame t to the next. The sum of squares is the integral of the squared
acceleration over time, so it does not depend on the frame rate.

a_t is the RMS acceleration of the values within `ACTIVITY_SPAN_S` of frame t, as far as it shows in frames a tenth
of a second apart, where the tremble that a detector causes is small. r is the image noise over its reference of
10 mm, and A the acceleration at which the weight is halved under that noise. More noise than R times the reference
makes people seem no faster, since most of it lasts (R is `MAX_NOISE_RATIO`). So the accelerations of a runner are
left alone, and those of people at rest with points as detectors give them are limited most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mocap_ros.solvers.joint.batch import VELOCITY_CHANGE_FRAMES, Batch, Subsample

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]

MAX_NOISE_RATIO = 1.9  # R; with it the weight of a run is 0.1 to 0.4 of that of rest, whatever the detector
ACTIVITY_SPAN_S = 0.5  # s; a step of a run takes 0.35 s, and a motion that begins or ends should show soon


@dataclass(frozen=True, eq=False)
class Acceleration:
    """What the two terms have in common.

    Attributes:
        weight: alpha.
        typical: A, in the unit of the values per s^2.
        velocity_change: (N, 3) as `Batch.velocity_change`.
        mean_square: (N,) a_t^2; 0 before it is measured.
        noise_ratio: (N,) r.
    """

    weight: float
    typical: float
    velocity_change: Array
    mean_square: Array
    noise_ratio: Array

    @classmethod
    def build(cls, weight: float, typical: float, batch: Batch) -> Self:
        """Return the term of a batch, before accelerations are measured, under the reference noise."""
        frames = len(batch.times)
        return cls(weight, typical, batch.velocity_change, np.zeros(frames), np.ones(frames))

    @cached_property
    def factors(self) -> Array:
        """(N, 3) factors of the values of three neighbours that give what is squared."""
        limit = self.typical * np.minimum(self.noise_ratio, MAX_NOISE_RATIO)
        weight = self.weight / (1 + (self.mean_square / limit**2) ** 2)
        return np.asarray(np.sqrt(weight)[:, None] * self.velocity_change)

    def with_noise_ratio(self, noise_ratio: Array) -> Self:
        """Return the term under another image noise, noise_ratio (N,) times the reference."""
        return replace(self, noise_ratio=noise_ratio)

    def with_activity(self, mean_square: Array) -> Self:
        """Return the term with measured mean square accelerations (N,)."""
        return replace(self, mean_square=mean_square)

    def subsampled(self, kept: Subsample) -> Self:
        """Return a term of value 0 for some frames: too far apart, they tell nothing of accelerations."""
        frames = len(kept.frames)
        return replace(
            self,
            velocity_change=np.zeros((frames, VELOCITY_CHANGE_FRAMES)),
            mean_square=np.zeros(frames),
            noise_ratio=np.ones(frames),
        )

    def with_components(self, k: int) -> Self:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the number of base poses."""
        return self


def measure_activity(values: Array, coarse: Batch, batch: Batch) -> Array:
    """Return the mean square acceleration of values about each frame of a batch, (N,).

    Args:
        values: (M, D) in some frames.
        coarse: layout of these frames.
        batch: layout of all frames; the same sequences.
    """
    squares = np.zeros(len(values))
    inner = len(values) - 2
    if inner > 0:
        c = coarse.velocity_change[:inner, :, None]
        change = c[:, 0] * values[:-2] + c[:, 1] * values[1:-1] + c[:, 2] * values[2:]
        squares[1:-1] = (change**2).sum(axis=1) * 2 / np.maximum(coarse.times[2:] - coarse.times[:-2], 1e-9)
    out = np.empty(len(batch.times))
    for p in range(len(batch.starts)):
        some = slice(coarse.starts[p], coarse.starts[p] + coarse.counts[p])
        every = slice(batch.starts[p], batch.starts[p] + batch.counts[p])
        sums = np.concatenate([[0.0], np.cumsum(squares[some])])
        first = np.searchsorted(coarse.times[some], batch.times[every] - ACTIVITY_SPAN_S)
        end = np.searchsorted(coarse.times[some], batch.times[every] + ACTIVITY_SPAN_S, side='right')
        out[every] = (sums[end] - sums[first]) / np.maximum(end - first, 1)
    return out
