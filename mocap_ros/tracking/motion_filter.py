# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A filter that takes the tremble out of a person's joints at the newest frame, where no later frame helps.

The errors of a detector, and with them those of the reconstruction, last for some frames. So a mean over more
frames would hardly lower them: the newest position z is the best there is, and a filter buys steadiness with
delay. The output x follows z as a mass on a damped spring does, which is what a linear-quadratic regulator gives
where errors of the position and of the acceleration have a price:

    d^2x/dt^2 = omega^2 (z - x) + 2 zeta omega (dz/dt - dx/dt)

From one frame to the next, h seconds later, the mass goes on with its velocity v, which fades with rate b, and the
new position pulls it by gains that give the filter the poles e^((-zeta +- i sqrt(1 - zeta^2)) omega h):

    x' = x + (1 - e^(-b h)) v / b,        v' = e^(-b h) v,                    rho = e^(-zeta omega h)
    x <- x' + (1 - rho^2) (z - x'),       v <- v' + beta / h (z - x'),
    beta = 1 + rho^2 - 2 rho cos(min(sqrt(1 - zeta^2) omega h, pi / 2))

Fast limbs need a stiff spring, for they soon turn round; where little trembles, a stiff one costs nothing. Where
the costs of delay and of tremble balance, the stiffness is a product of powers of both:

    omega = Omega (s^2 + s_0^2)^(p/2) (w / w_0)^(-q)

s is the speed of the point, the root mean square of |v| over the last frames; w is the standard deviation of the
tremble over the last frames, by the second differences of z, whose mean square is 6 w^2 (at uneven times they are
divided differences). Curved motion has second differences, too. So w of a joint is at most half the image noise at
the body, which the solver has estimated, and the filter lets exact points pass nearly unchanged.

The joints about the body's centre are filtered apart from the centre, which moves more evenly and trembles mostly
in depth. The coordinates of a joint share one w, and those of the centre have one each. The variance of a
coordinate of v is

    (f_w w omega)^2 + f_s^2 (s^2 + s_0^2) + f_0^2

for tremble and for motion that is not seen or followed, which is much in depth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, kernel
from mocap_ros.people import HIPS
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

# The constants of joints and the powers were chosen together on 53 trials of persons of the training data, with
# clean points and as three detectors give them: least errors of acceleration for 0.1 to 0.6 mm of the positions.
# `JOINT_STIFFNESS` and `TREMBLE_POWER` were set last, with other persons in sight (docs/method.md).
JOINT_STIFFNESS = 40.0  # rad/s at 1 m/s and w = w_0; Omega of joints
JOINT_DAMPING = 0.5  # 1; zeta of joints
JOINT_FADE_PER_S = 6.4  # 1/s; b of joints: limbs swing to and fro
CENTRE_STIFFNESS = 20.0  # rad/s at 1 m/s and w = w_0; Omega of the centre, by its place, acceleration and velocity
CENTRE_DAMPING = 1.0  # 1; zeta of the centre, whose steps should not overshoot
CENTRE_FADE_PER_S = 0.5  # 1/s; b of the centre: who walks goes on for some seconds
SPEED_POWER = 0.73  # 1; p
TREMBLE_POWER = 0.45  # 1; q
JOINT_SPEED_FLOOR_M_S = 0.055  # m/s; s_0 of joints, which somebody who stands still has
CENTRE_SPEED_FLOOR_M_S = 0.2  # m/s; s_0 of the centre, whose first solutions may be off by a tenth of the depth
TREMBLE_UNIT_M = 0.005  # m; w_0, what trembles with OpenPose's points
SPEED_MEMORY_S = 0.077  # s; time constant of the mean square of the speed
TREMBLE_MEMORY_S = 0.113  # s; time constant of that of the second differences, short for joints that are astray
MAX_RISE = 6.0  # mean squares; a single squared difference counts at most so much, for it may be an outlier
MAX_NOISE_SHARE = 0.5  # of the image noise; a joint rests on several frames and points
MIN_TREMBLE_M = 1e-4  # m; far below what is seen, keeps the stiffness finite
INITIAL_TREMBLE_M = 0.005  # m; until it is estimated
INITIAL_SPEED_M_S = 1.0  # m/s; that of a walker
# 1; f_w and f_s of x, y and z, by likelihood in these trials, then set so that two thirds of other persons' errors
# are within the standard deviation.
JOINT_TREMBLE_FACTORS = (1.6, 1.6, 0.5)
JOINT_SPEED_FACTORS = (0.0, 0.0, 0.62)
CENTRE_TREMBLE_FACTORS = (1.1, 1.1, 1.1)
CENTRE_SPEED_FACTORS = (0.14, 0.14, 0.55)
CENTRE_VELOCITY_FLOOR_M_S = 0.07  # m/s; f_0 of the centre, which rises and falls with each step
MAX_STEP_S = 0.2  # s; over a longer gap the differences say nothing of the tremble
MAX_SPEED_M_S = 10.0  # m/s; of a sprinter
MAX_DEPTH_CHANGE = 0.3  # of the depth; a larger change from frame to frame is no tremble but another solution
DIFFERENCE_FRAMES = 3  # frames that a second difference compares
DIFFERENCE_SQUARES = 6.0  # sum of the squared coefficients of a second difference at even times: 1, -2, 1
# Rows of the state: x, v, the mean squares of the second differences and of v, and the variance of v.
_X, _V, _SECOND, _SPEED, _VARIANCE = range(5)
STATE_ROWS = 5  # as many as these


class CoreMotion(NamedTuple):
    """The core of a person and its velocity in one frame, in the camera's optical frame.

    Attributes:
        joints: (J, 3) m.
        velocity: (J, 3) m/s; NaN if unknown.
        velocity_std: (J,) m/s, standard deviation of each joint's velocity; NaN if unknown.
        root_velocity_covariance: (3, 3) m^2/s^2, covariance of the velocity of the place between the hips; NaN if
            unknown.
    """

    joints: Array
    velocity: Array
    velocity_std: Array
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
        self._begin(stamp_ns, _split(joints))

    def _begin(self, stamp_ns: int, points: Array) -> None:
        self.stamps_ns: tuple[int, ...] = (stamp_ns,)
        self.recent = points[None]
        self.state = np.zeros((STATE_ROWS, *points.shape))
        self.state[_X] = points
        self.state[_SECOND] = DIFFERENCE_SQUARES * INITIAL_TREMBLE_M**2
        self.state[_SPEED] = INITIAL_SPEED_M_S**2 / 3
        self.state[_VARIANCE] = INITIAL_SPEED_M_S**2
        self.motion = CoreMotion(*_read(self.state))

    def advance(self, stamp_ns: int, joints: Array, image_noise: float) -> None:
        """Go on to a newer frame.

        Args:
            stamp_ns: ns, stamp of the frame, later than the one before.
            joints: (J, 3) m, unfiltered. Where they are too far away for a person to have moved there, another
                solution has been found, and the filter begins anew.
            image_noise: m at the body, standard deviation of a coordinate of an image point.
        """
        points, old = _split(joints), self.state[_X, -1].tolist()
        moved = MAX_SPEED_M_S * (stamp_ns - self.stamps_ns[-1]) / NS_PER_S
        if math.dist(old, points[-1].tolist()) > MAX_DEPTH_CHANGE * abs(old[2]) + moved:
            self._begin(stamp_ns, points)
            return
        kept = 1 - (DIFFERENCE_FRAMES if stamp_ns - self.stamps_ns[-1] <= MAX_STEP_S * NS_PER_S else 2)
        self.stamps_ns = (*self.stamps_ns[kept:], stamp_ns)
        self.recent = np.concatenate([self.recent[kept:], points[None]])
        times = np.array([(s - stamp_ns) / NS_PER_S for s in self.stamps_ns])
        self.state = advance_state(self.state, self.recent, times, MAX_NOISE_SHARE * image_noise)
        self.motion = CoreMotion(*_read(self.state))


@kernel(types.Tuple((FLOATS_2D, FLOATS_2D, FLOATS_1D, FLOATS_2D))(INPUT_3D))
def _read(state: Array) -> tuple[Array, Array, Array, Array]:
    """Return the attributes of `CoreMotion` from the state (5, J + 1, 3) of a filter.

    The errors of both hips are mostly the same, so the variance of the place between them is their mean.
    """
    count = state.shape[1] - 1
    joints, velocity = np.empty((count, 3)), np.empty((count, 3))
    std, covariance = np.empty(count), np.zeros((3, 3))
    for j in range(count):
        variance = 0.0
        for i in range(3):
            joints[j, i] = state[_X, j, i] + state[_X, count, i]
            velocity[j, i] = state[_V, j, i] + state[_V, count, i]
            variance += state[_VARIANCE, j, i] + state[_VARIANCE, count, i]
        std[j] = math.sqrt(variance)
    for i in range(3):
        of_hips = state[_VARIANCE, HIPS[0], i] + state[_VARIANCE, HIPS[1], i]
        covariance[i, i] = of_hips / 2 + state[_VARIANCE, count, i]
    return joints, velocity, std, covariance


@kernel(FLOATS_2D(INPUT_2D))
def _split(joints: Array) -> Array:
    """Return joints (J, 3) about their centre, followed by the centre: (J + 1, 3)."""
    count = len(joints)
    out = np.zeros((count + 1, 3))
    for j in range(count):
        out[count] += joints[j] / count
    for j in range(count):
        out[j] = joints[j] - out[count]
    return out


@kernel(void(INPUT_1D, FLOATS_1D))
def _write_difference(times: Array, out: Array) -> None:
    """Write the coefficients (3,) of the divided second difference at times (3,) s, scaled as at even times."""
    squares = 0.0
    for i in range(len(times)):
        product = 1.0
        for j in range(len(times)):
            if j != i:
                product *= times[i] - times[j]
        out[i] = 1 / product
        squares += out[i] * out[i]
    out *= math.sqrt(DIFFERENCE_SQUARES / squares)


@kernel(FLOATS_3D(INPUT_3D, INPUT_3D, INPUT_1D, FLOAT))
def advance_state(state: Array, recent: Array, times: Array, max_tremble: float) -> Array:
    """Return the state (5, N, 3) after the newest frame (formulas at the head of this module).

    Args:
        state: (5, N, 3) of the frame before.
        recent: (n, N, 3) m, unfiltered points of the newest frames; the last of the N points is the centre.
        times: (n,) s, their times.
        max_tremble: m, largest standard deviation of the tremble of a joint.
    """
    out = state.copy()
    frames, points = len(times), state.shape[1]
    step = times[-1] - times[-2]
    tremble_forgotten = 1 - math.exp(-step / TREMBLE_MEMORY_S)
    speed_forgotten = 1 - math.exp(-step / SPEED_MEMORY_S)
    coefficients = np.zeros(DIFFERENCE_FRAMES)
    if frames == DIFFERENCE_FRAMES:
        _write_difference(times, coefficients)
    for p in range(points):
        is_centre = p == points - 1
        for c in range(3):
            if frames == DIFFERENCE_FRAMES:
                difference = 0.0
                for i in range(DIFFERENCE_FRAMES):
                    difference += coefficients[i] * recent[i, p, c]
                old = state[_SECOND, p, c]
                out[_SECOND, p, c] += tremble_forgotten * (min(difference * difference, MAX_RISE * old) - old)
            out[_SPEED, p, c] += speed_forgotten * (state[_V, p, c] ** 2 - state[_SPEED, p, c])
        speed_floor = CENTRE_SPEED_FLOOR_M_S if is_centre else JOINT_SPEED_FLOOR_M_S
        squared_speed = out[_SPEED, p].sum() + speed_floor**2
        second = out[_SECOND, p].sum() / 3
        for c in range(3):
            if is_centre:
                stiffness, damping, fade = CENTRE_STIFFNESS, CENTRE_DAMPING, CENTRE_FADE_PER_S
                by_tremble, by_speed = CENTRE_TREMBLE_FACTORS[c], CENTRE_SPEED_FACTORS[c]
                floor = CENTRE_VELOCITY_FLOOR_M_S
                tremble = math.sqrt(out[_SECOND, p, c] / DIFFERENCE_SQUARES)
            else:
                stiffness, damping, fade = JOINT_STIFFNESS, JOINT_DAMPING, JOINT_FADE_PER_S
                by_tremble, by_speed = JOINT_TREMBLE_FACTORS[c], JOINT_SPEED_FACTORS[c]
                floor = 0.0
                tremble = min(math.sqrt(second / DIFFERENCE_SQUARES), max_tremble)
            tremble = max(tremble, MIN_TREMBLE_M)
            omega = stiffness * squared_speed ** (SPEED_POWER / 2) * (tremble / TREMBLE_UNIT_M) ** -TREMBLE_POWER
            rho = math.exp(-damping * omega * step)
            turn = min(math.sqrt(1 - damping * damping) * omega * step, math.pi / 2)  # rad; at most a quarter turn
            gain = 1 - rho * rho
            velocity_gain = (1 - rho) ** 2 + 2 * rho * (1 - math.cos(turn))
            kept = math.exp(-fade * step)
            x = state[_X, p, c] + (1 - kept) / fade * state[_V, p, c]
            innovation = recent[-1, p, c] - x
            out[_X, p, c] = x + gain * innovation
            out[_V, p, c] = kept * state[_V, p, c] + velocity_gain / step * innovation
            out[_VARIANCE, p, c] = (by_tremble * tremble * omega) ** 2 + by_speed**2 * squared_speed + floor**2
    return out
