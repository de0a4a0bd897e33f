# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A filter that takes the jitter out of a person's joints at the newest frame, where no later frame helps.

Errors of a detector last for some frames, so the newest position z is the best there is, and steadiness costs
delay. The output x follows z as a mass on a damped spring, which a linear-quadratic regulator gives where errors
of position and acceleration have a price:

    d^2x/dt^2 = omega^2 (z - x) + 2 zeta omega (dz/dt - dx/dt)

From one frame to the next, h seconds later, the velocity v fades with rate b, and the gains give the filter the
poles e^((-zeta +- i sqrt(1 - zeta^2)) omega h):

    x' = x + (1 - e^(-b h)) v / b,        v' = e^(-b h) v,                    rho = e^(-zeta omega h)
    x <- x' + (1 - rho^2) (z - x'),       v <- v' + beta / h (z - x'),
    beta = 1 + rho^2 - 2 rho cos(min(sqrt(1 - zeta^2) omega h, pi / 2))
    omega = Omega (s^2 + s_0^2)^(p/2) (w / w_0)^(-q)

s is the RMS speed of the point over the last frames, w the standard deviation of the jitter, by the second
differences of z, whose mean square is 6 w^2. As curved motion has these, too, w of a joint is at most half the
image noise at the body. The joints are filtered about the body's centre, and the centre apart, which jitters
mostly in depth. The coordinates of a joint share one w, those of the centre have one each. The variance of a
coordinate of v is

    (f_w w omega)^2 + f_s^2 (s^2 + s_0^2) + f_0^2

The constants are in `engine/motion.pyx`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.engine import motion as engine
from mocap_ros.people import HIPS
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

MAX_NOISE_SHARE = 0.5  # of the image noise; a joint rests on several frames and points
INITIAL_TREMBLE_M = 0.005  # m; until it is estimated
INITIAL_SPEED_M_S = 1.0  # m/s; that of a walker
MAX_STEP_S = 0.2  # s; over a longer gap the differences say nothing of the jitter
MAX_SPEED_M_S = 10.0  # m/s; of a sprinter
MAX_DEPTH_CHANGE = 0.3  # of the depth; a larger change from frame to frame is no jitter but another solution
DIFFERENCE_FRAMES = 3  # frames that a second difference compares
DIFFERENCE_SQUARES = 6.0  # sum of the squared coefficients of a second difference at even times: 1, -2, 1
# Rows of the state: x, v, the mean squares of the second differences and of v, and the variance of v.
_X, _V, _SECOND, _SPEED, _VARIANCE = range(5)
STATE_ROWS = 5  # as many as these


class CoreMotion(NamedTuple):
    """The core of a person and its velocity in one frame, in the camera's optical frame."""

    joints: Array  # (J, 3) m
    velocity: Array  # (J, 3) m/s; NaN if unknown
    velocity_std: Array  # (J,) m/s, standard deviation of each joint's velocity; NaN if unknown
    # (3, 3) m^2/s^2, covariance of the velocity of the point between the hips; NaN if unknown
    root_velocity_covariance: Array


class MotionFilter:
    """The filter of one person.

    Args:
        stamp_ns: ns, stamp of the first frame.
        joints: (J, 3) m, joints in that.

    Attributes:
        stamps_ns: ns, stamps of the newest frames, up to `DIFFERENCE_FRAMES`.
        recent: (n, J + 1, 3) m, unfiltered points of these frames: the joints about their centre, then the centre.
        state: (5, J + 1, 3) of each coordinate: x in m, v in m/s, the mean squares of the second differences in
            m^2 and of v in m^2/s^2, and the variance of v in m^2/s^2.
        motion: the filtered motion in the newest frame.
    """

    def __init__(self, stamp_ns: int, joints: Array) -> None:
        self._begin(stamp_ns, engine.split_centre(joints))

    def _begin(self, stamp_ns: int, points: Array) -> None:
        self.stamps_ns: tuple[int, ...] = (stamp_ns,)
        self.recent = points[None]
        self.state = np.zeros((STATE_ROWS, *points.shape))
        self.state[_X] = points
        self.state[_SECOND] = DIFFERENCE_SQUARES * INITIAL_TREMBLE_M**2
        self.state[_SPEED] = INITIAL_SPEED_M_S**2 / 3
        self.state[_VARIANCE] = INITIAL_SPEED_M_S**2
        self.motion = CoreMotion(*engine.read_motion(self.state, *HIPS))

    def advance(self, stamp_ns: int, joints: Array, image_noise: float) -> None:
        """Go on to joints (J, 3) m of a newer frame, at an image noise in m at the body.

        Where they are too far away for a person to have moved there, the filter begins anew.
        """
        points, old = engine.split_centre(joints), self.state[_X, -1].tolist()
        moved = MAX_SPEED_M_S * (stamp_ns - self.stamps_ns[-1]) / NS_PER_S
        if math.dist(old, points[-1].tolist()) > MAX_DEPTH_CHANGE * abs(old[2]) + moved:
            self._begin(stamp_ns, points)
            return
        kept = 1 - (DIFFERENCE_FRAMES if stamp_ns - self.stamps_ns[-1] <= MAX_STEP_S * NS_PER_S else 2)
        self.stamps_ns = (*self.stamps_ns[kept:], stamp_ns)
        self.recent = np.concatenate([self.recent[kept:], points[None]])
        times = np.array([(s - stamp_ns) / NS_PER_S for s in self.stamps_ns])
        self.state = engine.advance_motion(self.state, self.recent, times, MAX_NOISE_SHARE * image_noise)
        self.motion = CoreMotion(*engine.read_motion(self.state, *HIPS))
