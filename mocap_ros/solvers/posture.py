# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether a person stands, sits, crouches or lies, and with which probability.

A pose with the joints P and the vertical u shows four numbers, of both sides the means over those that were seen:

    trunk    u . (P_shoulder - P_hip) / |P_shoulder - P_hip|      1 upright, 0 level
    thigh    u . (P_hip - P_knee) / |P_hip - P_knee|              1 standing or on the knees, 0 seated
    shank    u . (P_knee - P_ankle) / |P_knee - P_ankle|          1 standing or on a chair, 0 on the knees
    balance  |h - (u . h) u| / l,    h = sum_j m_j P_j - (P_lankle + P_rankle) / 2

with m_j the share of the body's mass that joint j carries and l the length of a leg: 0 if the feet carry the body,
more the farther it leans or sits. In a posture, the numbers are distributed as a mixture of Gaussians, with the
shares s_k, means and deviations of `SHAPES`; what rests on a joint that was not seen says nothing:

    L(posture) = sum_k s_k prod_i N(number_i; mean_ki, std_ki),    i over the numbers that are known

What a person does hardly changes from frame to frame, and neither do the errors of poses. With h the time between
two frames, p the probabilities, and q those of people of whom nothing is known yet,

    p <- q + e^(-h / CHANGE_S) (p - q),    p <- p L^min(1, h / INDEPENDENT_S) / sum

In a whole sequence, p is also multiplied by p' / q, with p' the first of these two of the frames after, from the
last one backwards. What is none of the four, such as on the hands or upside down, is a fifth posture, which is not
named. Nor is any more than `FORGET_S` after the last frame in which a thigh was seen and the vertical was known.

`SHAPES` are those of the live poses of training persons, in motion capture and in the postures of
`training.postures`, by the detectors of the protocol.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Mask
from mocap_ros.geometry.level import MAX_CERTAIN_STD
from mocap_ros.models.upward_direction import MASSES
from mocap_ros.people import Posture
from mocap_ros.skeleton import CMU15, CORE_COUNT

CHANGE_S = 10.0  # s; for about this time people stay in a posture
INDEPENDENT_S = 0.2  # s; poses so far apart err independently
FORGET_S = 0.5  # s; a posture that was seen longer ago may have changed
MIN_PROBABILITY = 0.5  # 1; of a posture that is named
USUAL = np.array([0.02, 0.8, 0.1, 0.05, 0.03])  # q of each `Posture`
MIN_LENGTH_M = 1e-6  # m; guards divisions by the lengths of limbs


class _Shape(NamedTuple):
    posture: Posture  # unknown is the one that is not named
    share: float  # s_k
    mean: tuple[float, ...]  # (4,) trunk, thigh, shank and balance
    std: tuple[float, ...]  # (4,)


SHAPES = (
    _Shape(Posture.STANDING, 0.95, (0.97, 0.90, 0.90, 0.12), (0.11, 0.17, 0.13, 0.12)),
    _Shape(Posture.STANDING, 0.05, (0.12, 0.92, 0.75, 0.53), (0.33, 0.12, 0.18, 0.15)),  # bent over
    _Shape(Posture.SITTING, 0.79, (0.91, 0.21, 0.88, 0.36), (0.15, 0.29, 0.15, 0.20)),
    _Shape(Posture.SITTING, 0.21, (0.91, -0.03, 0.61, 0.65), (0.13, 0.37, 0.25, 0.24)),
    _Shape(Posture.CROUCHING, 0.90, (0.82, 0.38, 0.83, 0.17), (0.18, 0.26, 0.17, 0.14)),
    _Shape(Posture.CROUCHING, 0.10, (0.79, 0.94, 0.33, 0.56), (0.24, 0.12, 0.27, 0.15)),
    _Shape(Posture.LYING, 0.60, (0.05, -0.08, 0.00, 1.08), (0.20, 0.18, 0.25, 0.12)),
    _Shape(Posture.LYING, 0.20, (0.20, -0.65, 0.46, 0.93), (0.25, 0.15, 0.22, 0.15)),  # with the feet on the floor
    _Shape(Posture.LYING, 0.20, (-0.17, -0.82, -0.51, 0.74), (0.27, 0.20, 0.23, 0.19)),  # with raised legs
    _Shape(Posture.UNKNOWN, 0.25, (-0.11, 0.87, 0.48, 0.78), (0.32, 0.14, 0.18, 0.18)),  # on hands and feet
    _Shape(Posture.UNKNOWN, 0.20, (0.22, 0.93, -0.08, 0.81), (0.20, 0.11, 0.21, 0.13)),  # on hands and knees
    _Shape(Posture.UNKNOWN, 0.30, (-0.93, -0.62, -0.89, 0.40), (0.12, 0.25, 0.13, 0.24)),  # upside down
    _Shape(Posture.UNKNOWN, 0.25, (0.03, -0.23, 0.79, 0.89), (0.32, 0.31, 0.17, 0.14)),  # a bridge
)
_POSTURES, _SHARES, _MEANS, _STDS = (np.array(column) for column in zip(*SHAPES, strict=True))
_FACTORS = _SHARES * (np.arange(len(Posture))[:, None] == _POSTURES)  # (5, K) shares of the shapes of each posture
STATE = np.dtype((float, 1 + len(Posture)))  # s, when legs were seen last, and p then; NaN before the first frame
_SHOULDERS, _HIPS, _KNEES, _ANKLES = (
    [CMU15.index(side + joint) for side in 'lr'] for joint in ('shoulder', 'hip', 'knee', 'ankle')
)


def measure_shapes(joints: Array, inferred: Mask, vertical: Array) -> Array:
    """Return trunk, thigh, shank and balance (N, 4), NaN where they are not known, as `measure_likelihood`."""
    core, up = joints[:, :CORE_COUNT], vertical[:, None]
    seen = np.where(inferred[:, :CORE_COUNT, None], np.nan, core)
    shoulders, hips, knees, ankles = (seen[:, pair] for pair in (_SHOULDERS, _HIPS, _KNEES, _ANKLES))
    legs = np.linalg.norm(core[:, _HIPS] - core[:, _KNEES], axis=2)
    legs += np.linalg.norm(core[:, _KNEES] - core[:, _ANKLES], axis=2)
    off = MASSES @ core - ankles.mean(axis=1)
    aside = np.linalg.norm(off - (off * vertical).sum(axis=1, keepdims=True) * vertical, axis=1)
    limbs = [_measure_rise(a - b, up) for a, b in ((shoulders, hips), (hips, knees), (knees, ankles))]
    return np.stack([*limbs, aside / np.maximum(legs.mean(axis=1), MIN_LENGTH_M)], axis=1)


def measure_likelihood(joints: Array, inferred: Mask, vertical: Array, std: Array) -> Array:
    """Return L (N, 5) of each `Posture`, up to a factor; NaN where neither thigh or the vertical is known.

    Joints (N, J, 3) in m and what is inferred of them (N, J) begin with those of `CMU15`; the vertical (N, 3) or
    (1, 3) is a unit vector upwards, with its standard deviation (N,) or (1,) in rad.
    """
    numbers = measure_shapes(joints, inferred, vertical)
    exponents = np.nansum(-0.5 * ((numbers[:, None] - _MEANS) / _STDS) ** 2 - np.log(_STDS), axis=2)
    found = np.exp(exponents - exponents.max(axis=1, keepdims=True)) @ _FACTORS.T
    is_known = np.isfinite(numbers[:, 1]) & (std <= MAX_CERTAIN_STD)
    return np.where(is_known[:, None], found, np.nan)


def _measure_rise(limbs: Array, up: Array) -> Array:
    """Return u . l / |l| (N,) of limbs (N, 2, 3) of both sides; NaN where neither is known."""
    rise = (limbs * up).sum(axis=2) / np.maximum(np.linalg.norm(limbs, axis=2), MIN_LENGTH_M)
    return np.where(
        np.isnan(rise[:, 0]), rise[:, 1], np.where(np.isnan(rise[:, 1]), rise[:, 0], rise.mean(axis=1))
    )


def _expect(state: Array, times: Array) -> tuple[Array, Array]:
    """Return h (N,) in s, and p (N, 5) before what frames at some times (N,) in s show."""
    step = np.nan_to_num(np.abs(times - state[:, 0]), nan=np.inf)
    return step, USUAL + np.exp(-step / CHANGE_S)[:, None] * (np.nan_to_num(state[:, 1:]) - USUAL)


def follow_postures(state: Array, times: Array, likelihood: Array) -> None:
    """Advance the `STATE` (N, 6) of people, in place, by frames at times (N,) in s and L (N, 5) in them."""
    rows = np.flatnonzero(np.isfinite(likelihood[:, 0]))
    step, expected = _expect(state[rows], times[rows])
    weighed = expected * likelihood[rows] ** np.minimum(step / INDEPENDENT_S, 1.0)[:, None]
    state[rows, 0], state[rows, 1:] = times[rows], weighed / weighed.sum(axis=1, keepdims=True)


def name_postures(state: Array, times: Array) -> tuple[NDArray[np.int_], Array]:
    """Return the `Posture` (N,) of people at times (N,) in s and its probability (N,), 0 where none is named."""
    best, probability = state[:, 1:].argmax(axis=1), state[:, 1:].max(axis=1)
    is_named = (times - state[:, 0] <= FORGET_S) & (probability >= MIN_PROBABILITY) & (best > 0)
    return np.where(is_named, best, Posture.UNKNOWN), np.where(is_named, probability, 0.0)


def find_postures(times: Array, likelihood: Array) -> tuple[NDArray[np.int_], Array]:
    """Return the `Posture` (F,) of a person in a whole sequence, and its probability (F,); L is (F, 5)."""
    found = np.full((len(times), *STATE.shape), np.nan)
    state = found[:1].copy()
    for now in (slice(frame, frame + 1) for frame in range(len(times))):
        follow_postures(state, times[now], likelihood[now])
        found[now] = state
    state[:] = np.nan
    for now in (slice(frame, frame + 1) for frame in reversed(range(len(times)))):
        found[now, 1:] *= _expect(state, times[now])[1] / USUAL
        follow_postures(state, times[now], likelihood[now])
    found[:, 1:] /= found[:, 1:].sum(axis=1, keepdims=True)
    return name_postures(found, times)
