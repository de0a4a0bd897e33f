# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Learned correction of the velocities that the motion filter gives, from the last 0.8 s.

With v_j and v_0 the filter's velocities of joint j and of the root, between the hips, and B the axes of the body
(forward, left, up), the corrected velocities are

    v_j + l_j limit(B (c_0 + c_j)),        l_j = min(1, L s_j / |limit(B (c_0 + c_j))|)
    (c_1, ..., c_J, c_0) = W_1 a(W_0 x' + b_0) + b_1,        a(t) = t / (1 + e^-t)
    x = (u_j, m_kj - u_j, q_j, u_0, m_k0 - u_0, B^T e),      x' = (x - x_0) / x_s, within +-4

    u_0, u_j     B^T v_0, and B^T (v_j - v_0)
    m_k0, m_kj   mean velocities over each of the `SPANS_S` up to now, of the root and of the joint about it, in B
    q_j, e       joint about the root, in B; direction in which the root is seen, along which errors are largest
    s_j, L       the filter's standard deviation of v_j; `MAX_CORRECTION`
    limit        shortens the parts along and across the line of sight to those of the largest differences of the
                 mean velocities over 0.1 to 0.4 s from v_j

It is the mean of what the network says of the person and of the mirror image
(`benchmarks/velocity_correction.py`). With the correction d_j of a joint, d_0 of the root and its covariance S,
the standard deviation and the covariance become

    sqrt((f s_j)^2 + (g |d_j|)^2)        h^2 (f^2 S + g^2 d_0 d_0^T)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array, Array32
from mocap_ros.engine import motion as engine
from mocap_ros.skeleton import CMU15, HIPS

SPANS_S = (1 / 30, 0.1, 0.2, 0.4, 0.8)  # s; over which mean velocities are taken
# s; one of the `SPANS_S`, of a person's past without which nothing is corrected; training has hardly less
LEAST_PAST_S = 0.4
INPUT_LIMIT = 4.0  # standard deviations; there is next to nothing beyond in training
MAX_CORRECTION = 1.5  # standard deviations of the filter's velocity; one in 40 would be larger

_NEEDED = SPANS_S.index(LEAST_PAST_S)
# spans, counterparts of the joints and of the root, which is its own, and hips, as the engine reads them
SHAPE = np.array(SPANS_S), np.array([*CMU15.mirror, len(CMU15.mirror)]), np.array(HIPS)


class VelocityPast(NamedTuple):
    """What the corrections of P people rest on, in m, m/s and the camera's optical frame."""

    velocity: Array  # (P, J, 3) of the motion filter, in the order of `skeleton.CMU15`; NaN if not known
    std: Array  # (P, J) m/s, standard deviations of it
    joints: Array  # (P, J, 3) of the solution at the newest frame
    earlier: Array  # (P, 5, J, 3) of the solution at each of the `SPANS_S` before; NaN where not known
    axes: Array  # (P, 3, 3) axes of the body, in columns


@dataclass(frozen=True, eq=False)
class VelocityCorrection:
    """A network that was trained for this (formulas of the module); I inputs, H hidden units, J joints."""

    centre: Array32  # (I,) the x_0
    scale: Array32  # (I,) the x_s
    weight_0: Array32  # (I, H), with bias_0 (H,)
    bias_0: Array32
    weight_1: Array32  # (H, 3 (J + 1)), with bias_1 in m/s; the joints, then the root
    bias_1: Array32

    def correct(self, past: VelocityPast, root_covariance: Array) -> None:
        """Correct velocities, their deviations and the covariances (P, 3, 3) of roots where enough is known."""
        layers = self.centre, self.scale, self.weight_0, self.bias_0, self.weight_1, self.bias_1
        engine.correct_velocity(layers, past, root_covariance, INPUT_LIMIT, _NEEDED, MAX_CORRECTION, *SHAPE)
