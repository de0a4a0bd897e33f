# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Terms that keep the motion of poses and cameras smooth: finite differences over time.

    sum_t sum_f w_f (sum_e c_te x_(t+e)f)^2

with x_f the features of a frame: the K weights of the base poses, s R[:2], R[:2] and log s.
Of order 1 the terms are, with dt_t the time from frame t to the next,

    mu    sum_tl ((theta_(t+1)l - theta_tl) / sigma_l)^2 / dt_t    smoothness of the weights
  + gamma sum_t |M_(t+1) - M_t|^2 / dt_t                           flip regulariser, M = s R[:2] (TPAMI, eq. 12)
  + tau   sum_t |R_(t+1)[:2] z - R_t[:2] z|^2 / dt_t               tilt: the image of the vertical changes slowly
  + sigma sum_t (log s_(t+1) - log s_t)^2 / dt_t                   scale: people come nearer slowly

Of order 2 they are the integral of the squared acceleration of the weights and of R[:2], whatever the frame rate:

    sum_t alpha_t |v_(t+1) - v_t|^2 / h_t,    v_t = (x_(t+1) - x_t) / dt_t,    h_t = (dt_t + dt_(t+1)) / 2
    alpha_t = alpha / (1 + a_t^4 / (A r)^4)

The limit gives way to fast motion: a_t is the RMS acceleration within `ACTIVITY_SPAN_S` in frames a tenth of a
second apart, A that at which the weight is halved under the reference noise, and r the image noise over it,
between 1 and R.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mocap_ros.arrays import Array

if TYPE_CHECKING:
    from mocap_ros.solvers.joint.batch import Batch


CAMERA_FEATURES = 13  # s R[:2], R[:2] and log s
VERTICAL_FEATURES = (8, 11)  # of the camera: the image of the body's z axis
MIN_TIME_STEP_S = 1e-4  # s; guards the division by time steps, far below that of any camera
MAX_NOISE_RATIO = 1.9  # R; with it the weight of a run is 0.1 to 0.4 of that of rest, whatever the detector
ACTIVITY_SPAN_S = 0.5  # s; a step of a run takes 0.35 s, and a motion that begins or ends should show soon
TYPICAL_OF_POSE = 14.0  # m/s^2; A, over the root of the 15 joints 3.6 m/s^2, that of the joints of a walker
TYPICAL_OF_CAMERA = 4.2  # 1/s^2; A of a body that sways by 4 degrees once a second, and a half more


@dataclass(frozen=True, eq=False)
class FiniteDifference:
    """A weighted squared difference of order D of the features of neighbouring frames."""

    factors: Array  # (N, D + 1) c, 0 where the frames are not of one sequence
    weight: Array  # (F,) w; F = K + 13, or the features of another model

    @property
    def order(self) -> int:
        """D."""
        return self.factors.shape[1] - 1


def invert_time_steps(batch: Batch) -> Array:
    """Return the reciprocal of the time from each frame to the next (N,) 1/s; 0 after the last of a sequence."""
    inverse = np.zeros(len(batch.times))
    inverse[:-1] = 1 / np.maximum(batch.times[1:] - batch.times[:-1], MIN_TIME_STEP_S)
    inverse[batch.starts + batch.counts - 1] = 0.0
    return inverse


def weigh_velocity_change(batch: Batch) -> Array:
    """Return the factors (N, 3) of three neighbours that give (v_(t+1) - v_t) / sqrt(h_t)."""
    inverse = invert_time_steps(batch)
    a, b = inverse[:-1], inverse[1:]
    root = np.sqrt(2 * a * b / np.maximum(a + b, 1e-300))  # 0 where one of them is
    factors = np.zeros((len(inverse), 3))
    factors[:-1] = np.stack([a * root, -(a + b) * root, b * root], axis=-1)
    return factors


def limit_acceleration(
    weight: float, typical: float, velocity_change: Array, mean_square: Array, noise_ratio: Array
) -> Array:
    """Return sqrt(alpha_t) times the factors of the change of velocity (N, 3), by a_t^2 (N,) and r (N,)."""
    limit = typical * np.clip(noise_ratio, 1.0, MAX_NOISE_RATIO)
    return np.asarray(np.sqrt(weight / (1 + (mean_square / limit**2) ** 2))[:, None] * velocity_change)


def measure_activity(values: Array, coarse: Batch, batch: Batch) -> Array:
    """Return the mean square acceleration about each frame of a batch, (N,), of values (M, D) in some frames."""
    squares = np.zeros(len(values))
    if len(values) > 2:
        c = weigh_velocity_change(coarse)[:-2, :, None]
        change = c[:, 0] * values[:-2] + c[:, 1] * values[1:-1] + c[:, 2] * values[2:]
        squares[1:-1] = (change**2).sum(axis=1) * 2 / np.maximum(coarse.times[2:] - coarse.times[:-2], 1e-9)
    out = np.empty(len(batch.times))
    for some, every in zip(coarse.slices, batch.slices, strict=True):
        sums = np.concatenate([[0.0], np.cumsum(squares[some])])
        first = np.searchsorted(coarse.times[some], batch.times[every] - ACTIVITY_SPAN_S)
        end = np.searchsorted(coarse.times[some], batch.times[every] + ACTIVITY_SPAN_S, side='right')
        out[every] = (sums[end] - sums[first]) / np.maximum(end - first, 1)
    return out
