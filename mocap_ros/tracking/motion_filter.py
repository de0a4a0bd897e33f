"""A filter that takes the tremble out of a person's joints at the newest frame, where no later frame helps.

Each coordinate of each point (the body's centre, and the joints about it) has a Kalman filter of its own: a
position x and a velocity v that fades with rate b and is driven by white acceleration of spectral density q; r is
the variance of the white noise of the reconstruction. From one frame to the next, h seconds later,

    x <- x + (1 - e^(-b h)) v / b,    v <- e^(-b h) v
    P <- F P F^T + q [h^3/3  h^2/2; h^2/2  h],    F = [1  h; 0  e^(-b h)]

and the position z of the new frame corrects them by the gains (P_xx, P_xv) / (P_xx + r).

How much a person trembles depends on the detector, the camera and the joint, and how much a joint accelerates on
the motion, so r and q (of the centre r alone) are estimated from the last half second. The second and third
differences of the positions, scaled to sums of squared coefficients of 6 and 20 (at uneven times they are divided
differences), have the mean squares

    m_2 = 6 r + 2/3 q h^3,    m_3 = 20 r + q h^3

of which r and q follow. The jerk of fast limbs looks like noise, too. So the standard deviation of a joint's noise
is at most half the image noise at the body, n, which the solver has estimated: r <= (n / 2)^2. With exact points r
is near 0, and the filter lets everything pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, kernel
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

VELOCITY_FADE_PER_S = 2.0  # 1/s; b of joints: limbs swing to and fro, so a velocity lasts for half a second
CENTRE_VELOCITY_FADE_PER_S = 0.2  # 1/s; b of the centre: who walks goes on for some seconds
NOISE_MEMORY_S = 0.5  # s; time constant of the mean squares: long enough for an estimate, short for a new motion
# Share of the estimated density of the acceleration that is believed. The tremble is correlated over a few frames,
# which looks like acceleration. Chosen on persons of the training data, as the next.
ACCELERATION_SHARE = 0.3
MAX_RISE = 4.0  # mean squares; a single squared difference counts at most so much, for it may be an outlier
MIN_DENSITY = 1.0  # m^2/s^3; half of a walker's limbs', so that the filter never falls far behind a moving joint
MAX_DENSITY = 50.0  # m^2/s^3; of a kick
CENTRE_DENSITY = 0.3  # m^2/s^3; of the centre of a body that walks, not estimated, for its depth trembles too much
# Of the image noise; a joint rests on several frames and points. Chosen on persons of the training data: a third
# leaves more tremble, the whole costs 0.4 to 0.6 mm for runs.
MAX_NOISE_SHARE = 0.5
MIN_NOISE_M = 1e-4  # m; far below what is seen, keeps the gains defined
INITIAL_NOISE_M = 0.02  # m; noise of the first frames, until it is estimated
INITIAL_DENSITY = 0.3  # m^2/s^3, likewise
INITIAL_VELOCITY_M_S = 1.0  # m/s; standard deviation of a first velocity: that of a walker
NOMINAL_STEP_S = 1 / 30  # s; time step for which the initial mean squares are computed
MAX_STEP_S = 0.2  # s; over a longer gap the differences say nothing of the tremble
MAX_SPEED_M_S = 10.0  # m/s; of a sprinter
MAX_DEPTH_CHANGE = 0.3  # of the depth; a larger change from frame to frame is no tremble but another solution
DIFFERENCE_FRAMES = 4  # frames that a third difference compares
# Rows of the state: position, velocity, the three elements of P, and the two mean squares.
_X, _V, _PXX, _PXV, _PVV, _SECOND, _THIRD = range(7)
STATE_ROWS = 7  # as many as these


@dataclass(frozen=True, eq=False)
class MotionFilter:
    """The filter of one person; it is immutable, and `advance` returns a new one.

    Attributes:
        stamps_ns: ns, stamps of the newest frames, up to `DIFFERENCE_FRAMES`.
        recent: (n, J + 1, 3) m, unfiltered points of these frames: the joints about their centre, then the centre.
        state: (7, J + 1, 3) of each coordinate: x in m, v in m/s, P_xx, P_xv, P_vv, m_2 and m_3 in m^2.
    """

    stamps_ns: tuple[int, ...]
    recent: Array
    state: Array

    @staticmethod
    def begin(stamp_ns: int, joints: Array) -> MotionFilter:
        """Return the filter of a person who was reconstructed for the first time.

        Args:
            stamp_ns: ns, stamp of the frame.
            joints: (J, 3) m.
        """
        points = _split(joints)
        state = np.zeros((STATE_ROWS, *points.shape))
        state[_X] = points
        state[_PXX] = INITIAL_NOISE_M**2
        state[_PVV] = INITIAL_VELOCITY_M_S**2
        motion = INITIAL_DENSITY * NOMINAL_STEP_S**3
        state[_SECOND] = 6 * INITIAL_NOISE_M**2 + 2 / 3 * motion
        state[_THIRD] = 20 * INITIAL_NOISE_M**2 + motion
        return MotionFilter((stamp_ns,), points[None], state)

    @property
    def joints(self) -> Array:
        """(J, 3) m, filtered joints of the newest frame."""
        return np.asarray(self.state[_X, :-1] + self.state[_X, -1])

    @property
    def velocity(self) -> Array:
        """(J, 3) m/s, velocity of each joint at the newest frame."""
        return np.asarray(self.state[_V, :-1] + self.state[_V, -1])

    @property
    def velocity_variance(self) -> Array:
        """(J, 3) m^2/s^2, variance of each coordinate of `velocity`: that of a joint's own and of the centre's."""
        return np.asarray(self.state[_PVV, :-1] + self.state[_PVV, -1])

    def advance(self, stamp_ns: int, joints: Array, image_noise: float) -> MotionFilter:
        """Return the filter after a newer frame.

        Args:
            stamp_ns: ns, stamp of the frame, later than the one before.
            joints: (J, 3) m, unfiltered. Where they are too far away for a person to have moved there, another
                solution has been found, and the filter begins anew.
            image_noise: m at the body, standard deviation of a coordinate of an image point.
        """
        points = _split(joints)
        if self._is_elsewhere(stamp_ns, points[-1]):
            return MotionFilter.begin(stamp_ns, joints)
        stamps_ns = (*self.stamps_ns[1 - DIFFERENCE_FRAMES :], stamp_ns)
        recent = np.concatenate([self.recent[1 - DIFFERENCE_FRAMES :], points[None]])
        times = np.array([(s - stamp_ns) / NS_PER_S for s in stamps_ns])
        if times[-1] - times[-2] > MAX_STEP_S:
            stamps_ns, recent, times = stamps_ns[-2:], recent[-2:], times[-2:]
        return MotionFilter(
            stamps_ns, recent, advance_state(self.state, recent, times, MAX_NOISE_SHARE * image_noise)
        )

    def _is_elsewhere(self, stamp_ns: int, centre: Array) -> bool:
        """Return whether a centre (3,) m is farther away than a person moves and a depth trembles."""
        old, new = self.state[_X, -1].tolist(), centre.tolist()
        moved = MAX_SPEED_M_S * (stamp_ns - self.stamps_ns[-1]) / NS_PER_S
        return math.dist(old, new) > MAX_DEPTH_CHANGE * abs(old[2]) + moved


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
    """Write the coefficients (n,) of the divided difference of order n - 1 at times (n,) s.

    They are scaled to the sum of squares that they have at even times, 6 for n = 3 and 20 for n = 4.
    """
    squares = 0.0
    for i in range(len(times)):
        product = 1.0
        for j in range(len(times)):
            if j != i:
                product *= times[i] - times[j]
        out[i] = 1 / product
        squares += out[i] * out[i]
    out *= math.sqrt((6.0 if len(times) == 3 else 20.0) / squares)


@kernel(FLOATS_3D(INPUT_3D, INPUT_3D, INPUT_1D, FLOAT))
def advance_state(state: Array, recent: Array, times: Array, max_noise: float) -> Array:
    """Return the state (7, N, 3) after the newest frame (formulas at the head of this module).

    Args:
        state: (7, N, 3) of the frame before.
        recent: (n, N, 3) m, unfiltered points of the newest frames; the last of the N points is the centre.
        times: (n,) s, their times.
        max_noise: m, largest standard deviation of a joint's noise.
    """
    out = state.copy()
    frames, points = len(times), state.shape[1]
    step = times[-1] - times[-2]
    forgotten = 1 - math.exp(-step / NOISE_MEMORY_S)
    mean_step = (times[-1] - times[0]) / (frames - 1)
    second, third = np.zeros(3), np.zeros(4)
    if frames == DIFFERENCE_FRAMES:
        _write_difference(times[1:], second)
        _write_difference(times, third)
    for p in range(points):
        is_centre = p == points - 1
        least, most = (CENTRE_DENSITY, CENTRE_DENSITY) if is_centre else (MIN_DENSITY, MAX_DENSITY)
        fade = CENTRE_VELOCITY_FADE_PER_S if is_centre else VELOCITY_FADE_PER_S
        kept = math.exp(-fade * step)
        for c in range(3):
            if frames == DIFFERENCE_FRAMES:
                a = b = 0.0
                for i in range(3):
                    a += second[i] * recent[1 + i, p, c]
                for i in range(4):
                    b += third[i] * recent[i, p, c]
                old_a, old_b = state[_SECOND, p, c], state[_THIRD, p, c]
                out[_SECOND, p, c] += forgotten * (min(a * a, MAX_RISE * old_a) - old_a)
                out[_THIRD, p, c] += forgotten * (min(b * b, MAX_RISE * old_b) - old_b)
            cubed = mean_step**3
            motion = (10 / 3 * out[_SECOND, p, c] - out[_THIRD, p, c]) / (11 / 9)  # q h^3, from both mean squares
            motion = min(max(motion, least * cubed), most * cubed)
            noise = (out[_THIRD, p, c] - motion) / 20
            if not is_centre:
                noise = min(noise, max_noise * max_noise)
            noise = max(noise, MIN_NOISE_M**2)
            density = ACCELERATION_SHARE * motion / cubed
            pxx, pxv, pvv = state[_PXX, p, c], state[_PXV, p, c], state[_PVV, p, c]
            x = state[_X, p, c] + (1 - kept) / fade * state[_V, p, c]
            v = kept * state[_V, p, c]
            pxx = pxx + 2 * step * pxv + step * step * pvv + density * step**3 / 3
            pxv = kept * (pxv + step * pvv) + density * step * step / 2
            pvv = kept * kept * pvv + density * step
            gain_x, gain_v = pxx / (pxx + noise), pxv / (pxx + noise)
            innovation = recent[-1, p, c] - x
            out[_X, p, c], out[_V, p, c] = x + gain_x * innovation, v + gain_v * innovation
            out[_PXX, p, c] = (1 - gain_x) * pxx
            out[_PVV, p, c] = pvv - gain_v * pxv
            out[_PXV, p, c] = (1 - gain_x) * pxv
    return out
