# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Learned correction of the velocities that the motion filter gives, from the last 0.8 s.

With v_j and v_0 the filter's velocities of joint j and of the root, the place between the hips, and B the axes of
the body (forward, left, up), the corrected velocities are

    v_j + l_j limit(B (c_0 + c_j)),        l_j = min(1, L s_j / |limit(B (c_0 + c_j))|)
    (c_1, ..., c_J, c_0) = W_1 a(W_0 x' + b_0) + b_1,        a(t) = t / (1 + e^-t)
    x = (u_j, m_kj - u_j, q_j, u_0, m_k0 - u_0, B^T e),      x' = (x - x_0) / x_s, within +-4

    u_0, u_j     B^T v_0, and B^T (v_j - v_0)
    m_k0, m_kj   mean velocities over each of the `SPANS_S` up to now, by the solution, of the root and of the
                 joint about it, in these axes
    q_j          joint about the root, in these axes
    e            direction in which the root is seen, along which errors are largest
    s_j          the filter's standard deviation of v_j
    L            `MAX_CORRECTION`
    limit        shortens the parts of a vector along and across the line of sight to those of the differences
                 from v_j of the mean velocities over 0.1 to 0.4 s, the largest of each

The correction is the mean of what the network says of the person and of the mirror image. Where the mean
velocities agree with the filter's, nothing is corrected, as with exact points of a person who stands still or is
carried without stepping; with noise, little is. The network was also shown people whose whole body moves otherwise
than their limbs do, as on wheels or a treadmill (`benchmarks/velocity_correction.py`, which trains it).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import float32, types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_2D, INPUT_2D, INPUT_INTS_1D, kernel
from mocap_ros.people import HIPS
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

SPANS_S = (1 / 30, 0.1, 0.2, 0.4, 0.8)  # s; over which mean velocities are taken
# s; one of the `SPANS_S`, of a person's past without which nothing is corrected; training has hardly less
LEAST_PAST_S = 0.4
INPUT_LIMIT = 4.0  # standard deviations; there is next to nothing beyond in training
MAX_CORRECTION = 1.5  # standard deviations of the filter's velocity; one in 40 corrections would be larger
LIMIT_FIRST, LIMIT_LAST = 1, 4  # of the `SPANS_S`, 0.1 to 0.4 s; less has jitter, more remembers what has ended

MIN_LENGTH = 1e-300  # m/s; guards the division by the length of a correction of 0

_LEFT = 1  # index of the axis of the body whose sign a mirror changes
_FLIP = np.where(np.arange(3) == _LEFT, -1.0, 1.0)
_NEEDED = SPANS_S.index(LEAST_PAST_S)
_SPANS, _MIRROR = np.array(SPANS_S), np.array([*CMU15.mirror, len(CMU15.mirror)])  # the root is its own image
# types of kernels' arguments that they only read
_INPUT32_1D, _INPUT32_2D = (types.Array(float32, n, 'C', readonly=True) for n in (1, 2))


class VelocityPast(NamedTuple):
    """What the correction rests on, in m, m/s and the camera's optical frame.

    Attributes:
        velocity: (J, 3) of the motion filter, in the order of `skeleton.CMU15`.
        std: (J,) m/s, standard deviations of it.
        joints: (J, 3) of the solution at the newest frame.
        earlier: (5, J, 3) of the solution at each of the `SPANS_S` before; NaN where not known.
        axes: (3, 3) axes of the body, in columns.
    """

    velocity: Array
    std: Array
    joints: Array
    earlier: Array
    axes: Array


@dataclass(frozen=True, eq=False)
class VelocityCorrection:
    """A network that was trained for this (formulas of the module); I inputs, H hidden units, J joints.

    Attributes:
        centre: (I,) the x_0.
        scale: (I,) the x_s.
        weight_0: (I, H), with bias_0 (H,).
        weight_1: (H, 3 (J + 1)), with bias_1 in m/s; the joints, then the root.
    """

    centre: Array32
    scale: Array32
    weight_0: Array32
    bias_0: Array32
    weight_1: Array32
    bias_1: Array32

    def correct(self, past: VelocityPast) -> Array:
        """Return what is to be added to the velocities (J, 3) m/s; 0 where too little is known."""
        if np.isnan(past.earlier[_NEEDED, 0, 0]):
            return np.zeros_like(past.velocity)
        network = self.centre, self.scale, self.weight_0, self.bias_0, self.weight_1, self.bias_1
        found = _evaluate(build_inputs(past), _MIRROR, *network)
        return _limit(_turn(found[:-1] + found[-1], past.axes.T), past)


def build_inputs(past: VelocityPast) -> Array:
    """Return the inputs x (2, I) of a person and of the mirror image, neither centred nor scaled.

    What is not known of the past is as it would be if the person had moved as now.
    """
    mean = (past.joints - past.earlier) / _SPANS[:, None, None] - past.velocity
    points = np.concatenate([past.velocity[None], np.where(np.isnan(past.earlier), 0.0, mean), past.joints[None]])
    root = (points[:, HIPS[0]] + points[:, HIPS[1]]) / 2
    points -= root[:, None]
    root[-1] /= np.linalg.norm(root[-1])
    own = _turn(np.concatenate([points, root[:, None]], axis=1), past.axes)
    return np.stack([own, own[:, _MIRROR] * _FLIP]).reshape(2, -1)


def _turn(vectors: Array, axes: Array) -> Array:
    """Return vectors (..., 3) times axes (3, 3), summed in order, as BLAS may not do."""
    return np.asarray(vectors[..., :1] * axes[0] + vectors[..., 1:2] * axes[1] + vectors[..., 2:] * axes[2])


def _limit(wanted: Array, past: VelocityPast) -> Array:
    """Return corrections (J, 3) m/s, limited along and across the line of sight (the l_j)."""
    sight = past.joints[HIPS[0]] + past.joints[HIPS[1]]
    sight /= np.linalg.norm(sight)
    spans = slice(LIMIT_FIRST, LIMIT_LAST)
    apart = (past.joints - past.earlier[spans]) / _SPANS[spans, None, None] - past.velocity
    apart_along = (apart * sight).sum(axis=-1, keepdims=True)
    most_along = np.fmax.reduce(np.abs(apart_along), initial=0.0)
    apart_across = np.linalg.norm(apart - apart_along * sight, axis=-1, keepdims=True)
    most_across = np.fmax.reduce(apart_across, initial=0.0)
    along = (wanted * sight).sum(axis=-1, keepdims=True)
    across = wanted - along * sight
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    across *= np.where(length > most_across, most_across / np.maximum(length, MIN_LENGTH), 1.0)
    limited = across + np.clip(along, -most_along, most_along) * sight
    length = np.linalg.norm(limited, axis=-1, keepdims=True)
    most = MAX_CORRECTION * past.std[:, None]
    limited *= np.where(length > most, most / np.maximum(length, MIN_LENGTH), 1.0)
    return np.where(np.isfinite(length) & np.isfinite(most), limited, 0.0)


@kernel(void(float32, _INPUT32_1D, types.Array(float32, 1, 'C')))
def _add(factor: np.float32, values: Array32, out: Array32) -> None:
    """Add a factor times values (N,) to a vector (N,); whole arrays would be copied at each step."""
    for n in range(len(out)):
        out[n] += factor * values[n]


@kernel(
    FLOATS_2D(
        *(INPUT_2D, INPUT_INTS_1D, _INPUT32_1D, _INPUT32_1D), *(_INPUT32_2D, _INPUT32_1D, _INPUT32_2D, _INPUT32_1D)
    )
)
def _evaluate(
    inputs: Array,
    mirror: NDArray[np.int64],
    centre: Array32,
    scale: Array32,
    weight_0: Array32,
    bias_0: Array32,
    weight_1: Array32,
    bias_1: Array32,
) -> Array:
    """Return the mean (J + 1, 3) of what the network says of inputs (2, I) of a person and of the mirror image."""
    out = np.zeros((len(mirror), 3))
    for n in range(2):
        hidden, found = bias_0.copy(), bias_1.copy()
        for i in range(len(centre)):
            limited = min(max((inputs[n, i] - centre[i]) / scale[i], -INPUT_LIMIT), INPUT_LIMIT)
            _add(np.float32(limited), weight_0[i], hidden)
        for h in range(len(hidden)):
            _add(hidden[h] / (np.float32(1) + np.exp(-hidden[h])), weight_1[h], found)
        for j in range(len(mirror)):
            other = mirror[j] if n == 1 else j
            for i in range(3):
                value = found[3 * other + i] / 2
                out[j, i] += -value if n == 1 and i == _LEFT else value
    return out
