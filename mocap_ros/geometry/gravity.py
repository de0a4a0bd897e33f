# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which way is up by an accelerometer, which gravity seems to push upwards: its accelerations a, low-passed.

    g <- g + (1 - exp(-dt / T)) (a - g),    h <- h + (1 - exp(-dt / S)) (g - h)
    V <- V + (1 - exp(-dt / S)) (|g - h|^2 / 2 - V)

The direction is g / |g|. The accelerations of a robot that moves turn g to and fro, so its standard deviation
about each horizontal axis, sqrt(V) / |g|, is that of g about h, its own mean over longer.
"""

from __future__ import annotations

import math

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.units import NS_PER_S

LOW_PASS_S = 1.0  # s; T: steps and vibrations are shorter, and robots tilt more slowly
SPREAD_S = 10.0  # s; S: longer than a robot speeds up or brakes
FIRST_STD = 0.3  # m/s^2; sqrt(V) in the beginning: as large as errors of accelerometers
GRAVITY = 9.81  # m/s^2
MAX_DIFFERENCE = 1.0  # m/s^2; of |g| from `GRAVITY`: 4.5 m/s^2 to the side, or an accelerometer off by a tenth
MAX_STD = math.radians(5.0)  # rad; people who stand show the vertical as well as that
MAX_AGE_S = 2.0  # s; between an acceleration and what it is used for, or the next one, which then begins anew


class Gravity:
    """The direction upwards in the frame of an accelerometer, by its accelerations so far."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._mean, self._long_mean = np.zeros(3), np.zeros(3)  # m/s^2; g and h
        self._variance = 0.0  # m^2/s^4; V, 0 where nothing is known

    def add(self, stamp_ns: int, acceleration: Array) -> None:
        """Add an acceleration (3,) in m/s^2, its stamp in ns; one that is older than the newest has no effect."""
        step_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        if not self._variance or abs(step_s) > MAX_AGE_S:
            self._mean = self._long_mean = acceleration
            self._variance, step_s = FIRST_STD**2, 0.0
        elif step_s <= 0:
            return
        self._stamp_ns = stamp_ns
        share, long_share = (-math.expm1(-step_s / time_s) for time_s in (LOW_PASS_S, SPREAD_S))
        self._mean = self._mean + share * (acceleration - self._mean)
        self._long_mean = self._long_mean + long_share * (self._mean - self._long_mean)
        difference = self._mean - self._long_mean
        self._variance += long_share * (float(difference @ difference) / 2 - self._variance)

    def find(self, stamp_ns: int) -> tuple[Array, float]:
        """Return the direction (3,) upwards, a unit vector, and its standard deviation in rad, at a time in ns.

        Raises:
            InputError: nothing is known at that time, or it shows no direction.
        """
        if not self._variance:
            raise InputError('linear_acceleration_covariance[0] is -1: it measures no accelerations')
        age_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        if abs(age_s) > MAX_AGE_S:
            raise InputError(f'its newest acceleration is {abs(age_s):.1f} s away from the image')
        length = float(np.linalg.norm(self._mean))
        if abs(length - GRAVITY) > MAX_DIFFERENCE:
            raise InputError(
                f'linear_acceleration is {length:.2f} m/s^2 long in the mean, not {GRAVITY}: it has another unit, '
                'or no gravity in it'
            )
        std = math.sqrt(self._variance) / length
        if std > MAX_STD:
            raise InputError(f'the robot moves, so it shows the vertical to {math.degrees(std):.0f} degrees only')
        return self._mean / length, std
