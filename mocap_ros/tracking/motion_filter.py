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
mostly in depth. The coordinates of a joint share one w, those of the centre have one each. Omega of a joint's
depth is smaller, for most of the jitter is there, and of the lasting error, to which a delay adds little. The
variance of a coordinate of v is

    (f_w w omega)^2 + f_s^2 (s^2 + s_0^2) + f_0^2

Where they are too far away for a person to have moved there, the filter begins anew. The constants and the code
are in `engine/motion.pyx`.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import extremities, footing, motion
from mocap_ros.solvers.extremities import START
from mocap_ros.solvers.posture import STATE

# All that is filtered of a person, up to the frame that was shown last.
FILTERS = np.dtype(
    [
        ('motion', motion.MOTION),
        ('footing', footing.FOOTING),
        ('extremities', extremities.STATE),
        ('posture', STATE),
    ]
)


def _select(*names: str) -> slice:
    kind, start = FILTERS, 0
    for name in names:
        fields = kind.fields or MappingProxyType({})
        kind, at = fields[name][:2]
        start += at
    return slice(start // 8, (start + kind.itemsize) // 8)


# Columns of the filters (P, R) of people.
OF_MOTION, OF_FOOTING, OF_EXTREMITIES, OF_POSTURE = map(_select, ('motion', 'footing', 'extremities', 'posture'))
STANDING_TIME, STANDING_CORE, STANDING, _FOUND = (
    _select('footing', name) for name in ('time_s', 'core', 'standing', 'found')
)
SHIFT = slice(_FOUND.start + 9, _FOUND.start + 12)  # c, the first of the 9 unknowns of the newest frame
OFFSETS = _select('extremities', 'offsets')
# (R,) before the first frame
UNFILTERED = np.concatenate([np.full(OF_EXTREMITIES.start, np.nan), START, np.full(STATE.shape, np.nan)])


def restart_motion(filters: Array) -> Array:
    """Return the filters (R,) of a person of whom motion and footing are not known, as under another camera."""
    return np.concatenate([UNFILTERED[: OF_EXTREMITIES.start], filters[OF_EXTREMITIES.start :]])
