# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Roots that have inertia and feet that stand: what the image alone hardly shows, along the line of sight.

A change of scale looks like a step towards the camera, so the solved root X_t swims in depth, and feet with it.
With displacements c_t of the body and a_tf of each foot about it, as large as the errors of the solution are,

    E = sum_t |c_t - k_c c_(t-1)|^2_C / (1 - k_c^2) + sum_tf |a_tf - k_a a_(t-1)f|^2_A / (1 - k_a^2)
      + sum_t |v_(t+1) - v_t|^2_B / (h_t h_0 (1 + (|V_t| / V_0)^4))                            (inertia)
      + sum_ti p_ti rho(|y_(t+1)i - y_ti - R v_t dt_t|^2) / (S dt_t)^2                         (standing feet)
    v_t = (X_(t+1) + c_(t+1) - X_t - c_t) / dt_t,    y_ti = x_ti + c_t + a_tf

with k = exp(-dt / T), for errors of a solution last; x_ti heels and toes, p_ti the lesser of the probabilities
that one stands in two frames (`solvers.contacts`), 0 where that is not known, rho Cauchy's loss; |.|_C and |.|_B
weigh the line of sight and the directions across it, and |.|_A how a leg tilts in depth, which the image hardly
shows, and all else; live the two do not differ, for only later frames show how legs tilt. h_t is as in
`joint.differences` and h_0 = 1/30 s. In whole sequences, who is fast by the solved velocity V_t accelerates more.
What probably stands moves on with a share R of the root's velocity, for feet roll, and some have left the ground;
without it walks along the line of sight come out too short. Errors grow with the image noise n; and the more
precise the points, the less feet are held, for they roll by 0.05 to 0.1 m/s while they stand:

    C = C_0 + C_1 n,    A = A_0 + A_1 n,    S = S_0 sqrt(1 + (N / n)^2)

Beyond 5 m, C along the line of sight grows with the distance, as an error of the scale is a share of it.

Whole sequences are solved from all frames, in some rounds for rho; live, the newest frame is solved from all
frames so far, by one step of the same elimination (`engine.footing`), with rho about where inertia leads. An ankle
moves about its hip, and the knee as the lengths of the bones demand. All constants are chosen on training persons
(`benchmarks/feet.py`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import footing as engine
from mocap_ros.keypoints.rays import join_body
from mocap_ros.solvers.contacts import FEET, HEELS_AND_TOES, LEGS, NO_ODDS, find_contacts, follow_contacts
from mocap_ros.solvers.extremities import attach
from mocap_ros.solvers.observed_window import ObservedWindow

ERROR_M, ERROR_PER_NOISE = (0.03, 0.004), (0.5, 0.3)  # m and 1; C_0 and C_1, along the line of sight and across it
# m and 1; A_0 and A_1, but for tilts; with more, feet slide less and knees are worse
LEG_M, LEG_PER_NOISE = 0.004, 0.1
SLIP_M_S = 0.09  # m/s; S_0; with less, errors of contacts add up to errors of the place
PRECISE_M = 0.007  # m; N
ROUNDS = 3  # of the robust loss, over whole sequences
LEAST_NOISE_M = 5e-4  # m; image noise of points without errors
UNKNOWN = np.full(3, np.nan)  # (3,) vertical


class Knowledge(NamedTuple):
    """What depends on the frames that are known."""

    error_s: float  # s; T of c
    leg_s: float  # s; T of a
    along: float  # m/s^2; B along the line of sight
    across: float  # m/s^2; B across it
    tilt_m: float  # m; A_0 of tilts
    tilt_per_noise: float  # 1; A_1 of tilts
    pace: float  # m/s; V_0
    roll: float  # 1; R
    fast: float  # m/s; c of rho


OF_ALL = Knowledge(0.5, 0.2, 2.0, 3.5, 0.02, 0.6, 1.2, 0.05, 0.1)  # B of people who walk
OF_NEWEST = Knowledge(0.7, 0.1, 4.0, 7.0, LEG_M, LEG_PER_NOISE, math.inf, 0.3, 0.3)  # B of any


@lru_cache(maxsize=64)
def choose_numbers(noise: float, given: Knowledge) -> Array:
    """Return the fields of `engine.footing.Model` under an image noise in m at the body."""
    noise = max(noise, LEAST_NOISE_M)
    slip = SLIP_M_S * math.hypot(1, PRECISE_M / noise)
    error = [least + share * noise for least, share in zip(ERROR_M, ERROR_PER_NOISE, strict=True)]
    leg = given.tilt_m + given.tilt_per_noise * noise, LEG_M + LEG_PER_NOISE * noise
    lasting, acceleration = (given.error_s, given.leg_s), (given.along, given.across)
    return np.array([*error, *lasting, *acceleration, *leg, slip, given.pace, given.roll, given.fast])


def plant_sequence(observed: ObservedWindow, core: Array, offsets: Array, upward: Array, noise: float) -> Array:
    """Return the core joints (F, 15, 3) m of a sequence whose root has inertia and whose feet stand.

    Args:
        observed: the person in F frames of a camera that does not move.
        core: (F, 15, 3) m in the camera's axes.
        offsets: (F, 11, 3) m, extremities about their core joints.
        upward: (F, 3) unit vectors; NaN where they are not known.
        noise: m, image noise at the body.
    """
    rays, weight = join_body(observed.rays, observed.weight, observed.extremities)
    contact = np.nan_to_num(find_contacts(rays, weight, attach(core, offsets), upward, observed.times))
    are_feet_seen = np.any(weight[:, HEELS_AND_TOES] > 0, axis=0)  # else their ankles stand
    feet = np.ascontiguousarray(offsets[:, FEET] * are_feet_seen[:, None])
    numbers = choose_numbers(noise, OF_ALL)
    return engine.smooth(numbers, observed.times, np.ascontiguousarray(core), feet, contact, LEGS, ROUNDS)


class Footing(NamedTuple):
    """A person whose root has inertia and whose feet stand, in the newest frame; `advance` returns the next."""

    time_s: float
    core: Array  # (15, 3) m in the axes of the camera
    shift: Array  # (3,) m, displacement of the hips
    log_odds: Array  # (4,) logarithms of the odds that heels and toes stand; NaN where nothing is known
    memory: Array  # of the engine

    @property
    def contact(self) -> Array:
        """(2,) probabilities that heel or toe of the left and of the right foot stand; NaN where unknown."""
        return np.asarray(1 / (1 + np.exp(-np.fmax(self.log_odds[::2], self.log_odds[1::2]))))

    @staticmethod
    def advance(
        before: Footing | None,
        time_s: float,
        core: Array,
        offsets: Array,
        observed: ObservedWindow,
        frame: int,
        upward: Array | None,
        noise: float,
    ) -> Footing:
        """Return that of a frame of a window, by its solution; `before` is None in the first one.

        The offsets (11, 3) m are those of the frame before, else as `plant_sequence`.
        """
        feet, log_odds = offsets[FEET], NO_ODDS if before is None else before.log_odds
        log_odds = follow_contacts(log_odds, observed, frame, core, feet, UNKNOWN if upward is None else upward)
        memory = engine.begin() if before is None else before.memory.copy()
        step_s = 1.0 if before is None else time_s - before.time_s
        numbers = choose_numbers(round(noise, 4), OF_NEWEST)
        planted = engine.advance(memory, numbers, step_s, core, feet, np.fmax(log_odds, -math.inf), LEGS)
        return Footing(time_s, planted, planted[LEGS[0, 0]] - core[LEGS[0, 0]], log_odds, memory)
