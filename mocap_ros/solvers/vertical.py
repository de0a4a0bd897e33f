# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The vertical of a camera, and lifted poses turned towards it.

How far a body leans along the line of sight hardly shows, so lifted poses lean to and fro. Each pose shows a
direction upwards u (`models.upward_direction`); the vertical v of a camera is their robust mean over people and
some time:

    v_t = normalise(sum_i max(p_i, P) k_i u_i),    k_i = exp(-|t - t_i| / T) dt_i / (1 + (angle(u_i, v) / A)^2)
    s_v = min(S sqrt(C / sum_i p_i k_i), MAX_STD_DEG)

with p_i the share to which the pose stands and dt_i the time to the next frame; live, the sums are over the frames
before t. Directions of one person within the time C have nearly one error. Each lifted pose y is then turned about
the horizontal axis of its virtual camera, by phi, the angle about that axis from u to v:

    y' = R_x(p g phi / (1 + (phi / B)^2)) y,    g = s_y^2 / (s_y^2 + s_u^2 + s_v^2)

s_y = KAPPA sigma_z / r is the standard deviation of the lean of a lifted pose of radius r and depths sigma_z, and
s_u that of the angle from u to the vertical in true poses. The lifter gets a vertical that is given as well, to
the share p, but none that was found, which rests on its own poses and makes left-out persons 1 mm worse (the
turns: 0.3 better).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import TrackerConfig
from mocap_ros.engine import vertical as engine
from mocap_ros.errors import ConfigError
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.upward_direction import find_standing, find_upward
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

AUTO, NONE = 'auto', 'none'  # values of `tracker.vertical` besides three numbers
# Constants of the formulas above; angles in degrees. All were measured on training persons seen by the protocol's
# detectors from elevations of 0 to 32 degrees.
MEMORY_S = 20.0  # s; T: long for people who turn about, short enough for a camera that is moved
DIRECTION_STD_DEG = 8.0  # S: of the direction that a lifted pose shows
CORRELATION_S = 4.0  # s; C: means over so long still differ by almost as much as those of single frames
MAX_STD_DEG = 25.0  # of a vertical of which next to nothing is known: that of people who sit all the time
GIVEN_STD_DEG = 1.0  # s_v of a vertical that is given: that of a spirit level or an accelerometer at rest
MAX_STEP_S = 0.2  # s; longest time that one frame stands for
UNIT_TOLERANCE = 0.01  # 1; difference of a given direction's length from 1 that rounding may cause


@dataclass(frozen=True, eq=False)
class Vertical:
    """What is known of the vertical of a camera; it is immutable, and `advance` returns a new one."""

    direction: Array  # (3,) unit vector upwards in the camera's optical frame
    # s, for how long people have been seen standing, those of long ago counting less; infinite where it is given
    seconds: float
    stamp_ns: int = 0  # ns, stamp of the newest frame that it rests on
    weight: float = 0.0  # s, the same, in which those who do not stand count at least `MIN_STANDING`

    @property
    def std(self) -> float:
        """Standard deviation of the direction in rad."""
        if self.is_given:
            return math.radians(GIVEN_STD_DEG)
        std_deg = DIRECTION_STD_DEG * math.sqrt(CORRELATION_S / max(self.seconds, 1e-9))
        return math.radians(min(std_deg, MAX_STD_DEG))

    @property
    def is_given(self) -> bool:
        """Whether the direction was given, so that it owes nothing to lifted poses."""
        return math.isinf(self.seconds)

    @staticmethod
    def begin(stamp_ns: int, upward: Array) -> Vertical:
        """Return the vertical that the first poses show; upward (P, 3), P >= 1, stamp in ns."""
        total = upward.sum(axis=0)
        return Vertical(total / max(float(np.linalg.norm(total)), 1e-9), 0.0, stamp_ns)

    def advance(self, stamp_ns: int, upward: Array, standing: Array) -> Vertical:
        """Return the vertical after a later frame, by directions (P, 3) of people who stand to shares (P,)."""
        if self.is_given:
            return self
        age_s = (stamp_ns - self.stamp_ns) / NS_PER_S
        faded = math.exp(-age_s / MEMORY_S)
        kept, step_s = faded * self.weight, min(age_s, MAX_STEP_S)
        direction, weight, seconds = engine.add_frame(
            self.direction, kept, step_s, np.ascontiguousarray(upward), standing
        )
        return Vertical(direction, faded * self.seconds + seconds, stamp_ns, kept + weight)

    def forget(self) -> Vertical | None:
        """Return what is left when the camera may have changed: a vertical that was given."""
        return self if self.is_given else None


def read_given_vertical(config: TrackerConfig) -> Vertical | None:
    """Return the vertical that `tracker.vertical` gives; None where it is to be found, or not to be used.

    Raises:
        ConfigError: The parameter is neither a word that it may be nor a unit vector of three numbers.
    """
    text = config.vertical
    if text in (AUTO, NONE):
        return None
    try:
        direction = np.array([float(word) for word in text.replace(',', ' ').split()])
    except ValueError:
        direction = np.empty(0)
    if direction.shape != (3,) or not abs(float(np.linalg.norm(direction)) - 1) <= UNIT_TOLERANCE:
        raise ConfigError(
            f'tracker.vertical = {text!r}: expected auto, none, or a unit vector upwards in the optical frame of '
            "the camera, such as '0 -1 0' of a level camera"
        )
    return Vertical(direction / np.linalg.norm(direction), math.inf)


def lift_under_vertical(
    lifter: Lifter, points: Array, weight: Array, focal: float, vertical: Array | None, std: Array | None
) -> LiftedPoses:
    """Lift poses under a vertical that is given, to the share to which the poses without it stand.

    The arguments are those of `Lifter.lift`; the vertical is None where none is given.
    """
    plain = lifter.lift(points, weight, focal)
    if vertical is None:
        return plain
    under = lifter.lift(points, weight, focal, vertical, std)
    share = find_standing(plain.joints)[:, None, None]
    return LiftedPoses(*(a + share * (b - a) for a, b in ((plain.joints, under.joints), (plain.std, under.std))))


def turn_towards_vertical(lifted: LiftedPoses, vertical: Array, std: Array) -> LiftedPoses:
    """Return lifted poses turned towards the vertical (formulas of this module).

    `lifted` poses of F frames in the axes of their virtual cameras, NaN where they are not known; `vertical` (F,
    3) vertical in the same axes; `std` (F,) rad, standard deviation of the vertical.
    """
    joints = engine.turn_poses(
        np.ascontiguousarray(lifted.joints),
        np.ascontiguousarray(lifted.std),
        find_upward(lifted.joints),
        np.ascontiguousarray(vertical),
        np.ascontiguousarray(std),
        find_standing(lifted.joints),
        CORE_COUNT,
    )
    return LiftedPoses(joints, lifted.std)


def find_vertical(times: Array, upward: Array, standing: Array) -> tuple[Array, Array]:
    """Return the vertical of a whole sequence, found from all its frames.

    `times` (F,) s, increasing; `upward` (F, 3) directions upwards that the poses of one person show, in the
    optical frame of the camera, NaN where there is no pose; `standing` (F,) shares to which the poses stand.
    Returns (F, 3) unit vectors and (F,) rad, their standard deviations; NaN where no frame has a pose.
    """
    known = np.asarray(np.isfinite(upward).all(axis=1))
    if not known.any():
        return np.full(upward.shape, np.nan), np.full(len(times), np.nan)
    steps = np.minimum(np.diff(times, append=times[-1]), MAX_STEP_S)
    steps[-1] = steps[-2] if len(steps) > 1 else MAX_STEP_S
    weight = np.where(known, np.maximum(steps, 1e-9), 0.0)
    shares = np.where(known, standing, 0.0)
    directions, seconds = engine.find_sequence(times, np.where(known[:, None], upward, 0.0), weight, shares)
    std_deg = DIRECTION_STD_DEG * np.sqrt(CORRELATION_S / np.maximum(seconds, 1e-9))
    return directions, np.radians(np.minimum(std_deg, MAX_STD_DEG))
