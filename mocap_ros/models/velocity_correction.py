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

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import float32, types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, INPUT_INTS_1D, kernel
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

_LEFT = 1  # index of the axis of the body whose sign a mirror changes
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
        return _apply(_evaluate(build_inputs(past), _MIRROR, *network), *past, _SPANS)


def build_inputs(past: VelocityPast) -> Array:
    """Return the inputs x (2, I) of a person and of the mirror image, neither centred nor scaled."""
    return _build_inputs(past.velocity, past.joints, past.earlier, past.axes, _SPANS, _MIRROR)


@kernel(FLOATS_3D(INPUT_2D, INPUT_2D, INPUT_3D, INPUT_1D))
def _collect_points(velocity: Array, joints: Array, earlier: Array, spans: Array) -> Array:
    """Return velocities, mean velocities less these, and places (T + 2, J + 1, 3) about the root, which is last.

    The last of the places is the direction in which the root is seen. What is not known of the past is as it would
    be if the person had moved as now.
    """
    count, times = len(joints), len(spans)
    left, right = HIPS
    points = np.empty((times + 2, count + 1, 3))
    points[0, :count], points[times + 1, :count] = velocity, joints
    for k in range(times):
        for j in range(count):
            is_known = not math.isnan(earlier[k, j, 0])
            for i in range(3):
                mean = (joints[j, i] - earlier[k, j, i]) / spans[k]
                points[1 + k, j, i] = mean - velocity[j, i] if is_known else 0.0
    for k in range(times + 2):
        points[k, count] = (points[k, left] + points[k, right]) / 2
        for j in range(count):
            points[k, j] -= points[k, count]
    points[times + 1, count] /= math.sqrt((points[times + 1, count] ** 2).sum())
    return points


@kernel(FLOATS_2D(INPUT_2D, INPUT_2D, INPUT_3D, INPUT_2D, INPUT_1D, INPUT_INTS_1D))
def _build_inputs(
    velocity: Array, joints: Array, earlier: Array, axes: Array, spans: Array, mirror: NDArray[np.int64]
) -> Array:
    """Compute `build_inputs`."""
    points = _collect_points(velocity, joints, earlier, spans)
    count = points.shape[1]
    out = np.zeros((2, points.size))
    for k in range(len(points)):
        for j in range(count):
            own, other = 3 * (k * count + j), 3 * (k * count + mirror[j])
            for i in range(3):
                for a in range(3):
                    out[0, own + i] += axes[a, i] * points[k, j, a]
                out[1, other + i] = -out[0, own + i] if i == _LEFT else out[0, own + i]
    return out


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


@kernel(FLOATS_2D(INPUT_2D, INPUT_2D, INPUT_1D, INPUT_2D, INPUT_3D, INPUT_2D, INPUT_1D))
def _apply(
    found: Array, velocity: Array, std: Array, joints: Array, earlier: Array, axes: Array, spans: Array
) -> Array:
    """Return the corrections (J, 3) m/s for what the network says (J + 1, 3) of a past, limited (the l_j)."""
    out, sight = np.zeros(velocity.shape), joints[HIPS[0]] + joints[HIPS[1]]
    sight /= math.sqrt((sight**2).sum())
    for j in range(len(out)):
        for i in range(3):
            for a in range(3):
                out[j, i] += axes[i, a] * (found[j, a] + found[len(out), a])
        along, most_along, most_across = (out[j] * sight).sum(), 0.0, 0.0
        for k in range(LIMIT_FIRST, LIMIT_LAST):
            apart = (joints[j] - earlier[k, j]) / spans[k] - velocity[j]
            apart_along = (apart * sight).sum()
            most_along = max(most_along, abs(apart_along))  # not with NaN, which is not larger
            most_across = max(most_across, math.sqrt(((apart - apart_along * sight) ** 2).sum()))
        across = out[j] - along * sight
        squared = (across**2).sum()
        if squared > most_across**2:
            across *= most_across / math.sqrt(squared)
        out[j] = across + min(max(along, -most_along), most_along) * sight
        length, most = math.sqrt((out[j] ** 2).sum()), MAX_CORRECTION * std[j]
        if not (math.isfinite(length) and math.isfinite(most)):
            out[j] = 0.0
        elif length > most:
            out[j] *= most / length
    return out
