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
that one stands in two frames, 0 where that is not known, rho Cauchy's loss; |.|_C and |.|_B weigh the line of
sight and the directions across it, and |.|_A how a leg tilts in depth, which the image hardly shows, and all
else; live the two do not differ, for only later frames show how legs tilt. h_t is as in
`joint.differences` and h_0 = 1/30 s. In whole sequences, who is fast by the solved velocity V_t accelerates more.
What probably stands moves on with a share R of the root's velocity, for feet roll, and some have left the ground;
without it walks along the line of sight come out too short. Errors grow with the image noise n; and the more
precise the points, the less feet are held, for they roll by 0.05 to 0.1 m/s while they stand:

    C = C_0 + C_1 n,    A = A_0 + A_1 n,    S = S_0 sqrt(1 + (N / n)^2)

Beyond 5 m, C along the line of sight grows with the distance, as an error of the scale is a share of it.

Whole sequences are solved from all frames, in some rounds for rho; live, the newest frame is solved from all
frames so far, by one step of the same elimination (`engine.footing`), with rho about where inertia leads. An ankle
moves about its hip, and the knee as the lengths of the bones demand. All constants, in `engine/footing.pyx`, are
chosen on training persons (`benchmarks/feet.py`).

How probable it is that heels and toes stand follows from how fast they move in the image and how low they are. The
ray r of a point follows a straight line within 0.1 s, or two and a half frames where these are rare; its slope, at
the depth z of the solution, is the speed v = z |dr/dt|. a_h is the height over the lowest point of both feet.
Whether it stands changes at random, once in tau_h on average, and each frame multiplies the odds, forwards and
backwards in time (exact for such a Markov chain):

    p_t / (1 - p_t) = f_t b_t,    f_t = g(f_{t-1}) exp(e_t),    b_t = g(b_{t+1} exp(e_{t+1}))
    e_t = w_t dt_t / tau_e max(K - v^2 / (V_s^2 + V_n^2 n^2) - a_h^2 / (H^2 + H_n^2 n^2), -D)
    K = log((V_m^2 + V_n^2 n^2) / (V_s^2 + V_n^2 n^2))
    g(f) = (f (1 + q) + 1 - q) / (f (1 - q) + 1 + q),    q = exp(-dt / tau_h)

with w_t the score. Noise n makes speeds and heights of points that stand, and V_m is the speed of those that move.
The newest frame of a window has no later ones, so what it gets is what is known live. The constants give about the
least logarithmic loss on training persons and on the recorded detections, whole and live.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import footing as engine
from mocap_ros.keypoints.rays import join_body
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.solvers.extremities import attach
from mocap_ros.solvers.observed_window import ObservedWindow

ROUNDS = 3  # of the robust loss, over whole sequences
UNKNOWN = np.full(3, np.nan)  # (3,) vertical
HEELS_AND_TOES = tuple(BODY26.index(joint) for joint in ('lheel', 'ltoe', 'rheel', 'rtoe'))
ANKLES = tuple(BODY26.index(joint) for joint in ('lankle', 'lankle', 'rankle', 'rankle'))  # of these points
FEET = np.array(HEELS_AND_TOES) - CORE_COUNT  # heels and toes among the extremities
LEGS = np.array([[CMU15.index(side + joint) for joint in ('hip', 'knee', 'ankle')] for side in 'lr'])


def find_contacts(rays: Array, weight: Array, joints: Array, upward: Array, times: Array, noise: float) -> Array:
    """Return the probabilities (F, 4) that left heel and toe, right heel and toe stand; NaN where unknown.

    The camera does not move. J is 26 or 15. In a layout without feet, both points of a foot are its ankle.

    Args:
        rays: (F, J, 2) x / z and y / z of the points of `BODY26` or `CMU15` in the camera; finite.
        weight: (F, J) scores in [0, 1]; 0 where a point was not seen.
        joints: (F, J', 3) m, the same joints of a solution in the camera's axes; NaN where there is none.
        upward: (3,) or (F, 3) unit vectors upwards in these axes; NaN where they are not known.
        times: (F,) s, increasing.
        noise: m, image noise at the body.
    """
    core, feet = joints[:, :CORE_COUNT], np.zeros((len(times), len(FEET), 3))
    if joints.shape[1] > CORE_COUNT:
        feet = joints[:, HEELS_AND_TOES] - core[:, ANKLES]
    return engine.find_contacts(
        times,
        rays[:, :CORE_COUNT],
        weight[:, :CORE_COUNT],
        rays[:, CORE_COUNT:],
        weight[:, CORE_COUNT:],
        core,
        feet,
        np.broadcast_to(upward, core[:, 0].shape),
        LEGS,
        FEET,
        noise,
    )


def plant_sequence(
    observed: ObservedWindow,
    core: Array,
    offsets: Array,
    upward: Array,
    noise: float,
    ahead: Array | None = None,
) -> Array:
    """Return the core joints (F, 15, 3) m of a sequence whose root has inertia and whose feet stand.

    Args:
        observed: the person in F frames of a camera that does not move.
        core: (F, 15, 3) m in the camera's axes.
        offsets: (F, 11, 3) m, extremities about their core joints.
        upward: (F, 3) unit vectors; NaN where they are not known.
        noise: m, image noise at the body.
        ahead: (F, 2) measured displacements along the optical axis in m, and their information in 1/m^2, 0 where
            nothing is measured; None without depths.
    """
    rays, weight = join_body(observed.rays, observed.weight, observed.extremities)
    contact = np.nan_to_num(find_contacts(rays, weight, attach(core, offsets), upward, observed.times, noise))
    are_feet_seen = np.any(weight[:, HEELS_AND_TOES] > 0, axis=0)  # else their ankles stand
    feet = np.ascontiguousarray(offsets[:, FEET] * are_feet_seen[:, None])
    return engine.smooth(noise, observed.times, np.ascontiguousarray(core), feet, contact, LEGS, ROUNDS, ahead)


def plant_newest(
    footings: Array,
    times: Array,
    windows: Sequence[ObservedWindow],
    frames: Sequence[int],
    core: Array,
    offsets: Array,
    upward: Array | None,
    noise: Array,
    ahead: Array | None = None,
) -> None:
    """Overwrite the core joints (P, 15, 3) m of people by those of a root with inertia and feet that stand.

    They are of a frame of each of P windows, given by its index; later ones take no part. One that is not newer
    than the last changes nothing, and if it is the last, it has its core. `footings` (P, N) are `engine.FOOTING`,
    NaN before the first frame; times (P,) in s grow from frame to frame; offsets (P, 11, 3) m of the extremities
    are those of the frame before; `upward` (3,) is None where it is not known; noise (P,) in m is that of the
    image at the body; `ahead` (P, 2) is as of `plant_sequence`, NaN of people
    without depths.
    """
    feet, up = offsets.take(FEET, axis=1), UNKNOWN if upward is None else upward
    engine.follow_contacts(footings, times, windows, frames, core, feet, up, LEGS, FEET, noise)
    engine.advance(footings, times, noise, core, feet, LEGS, ahead)
