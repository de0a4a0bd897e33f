# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How probable it is that heels and toes stand, from how fast they move in the image and how low they are.

The ray r of a point follows a straight line within `HALF_WINDOW_S`, whose slope, at the depth z of the solution,
is its speed v = z |dr/dt|; a_h is its height over the lowest point of both feet. Whether it stands changes at
random, once in T on average, and each frame multiplies the odds, forwards and backwards in time (exact for such a
Markov chain):

    p_t / (1 - p_t) = f_t b_t,    f_t = g(f_{t-1}) exp(e_t),    b_t = g(b_{t+1} exp(e_{t+1}))
    e_t = w_t dt_t / E max(B - (v / V)^2 - (a_h / H)^2, -D)
    g(f) = (f (1 + k) + 1 - k) / (f (1 - k) + 1 + k),    k = exp(-dt / T)

with w_t the score. The newest frame of a window has no later ones, so what it gets is what is known live. The
constants give the least logarithmic loss on training persons, seen whole: recall 0.94, 0.81 and 0.75 and precision
0.83, 0.85 and 0.90 with clean, OpenPose-like and MediaPipe-like points; in the newest frame 0.86, 0.76 and 0.70,
and 0.74, 0.74 and 0.78.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26

Array = NDArray[np.float64]

HEELS_AND_TOES = tuple(BODY26.index(joint) for joint in ('lheel', 'ltoe', 'rheel', 'rtoe'))
ANKLES = tuple(BODY26.index(joint) for joint in ('lankle', 'lankle', 'rankle', 'rankle'))  # of these points
HALF_WINDOW_S = 0.1  # s; a longer one blurs short stands, and in a shorter one a detector's noise hides them
SPEED_M_S = 0.2  # m/s; V
HEIGHT_M = 0.07  # m; H
EVIDENCE_S = 0.2  # s; E: as near frames share points and errors, those of so long count as one
STANDING, MOVING = 3.0, 4.0  # 1; B and D
HOLD_S = 1.0  # s; T
MAX_STEP_S = 0.1  # s; longest time that one frame stands for
MIN_KNOWN = 0.025  # 1; |p - 1/2| below which nothing is known of a point that is not seen, after about 3 s


class Contacts(NamedTuple):
    """Whether left heel and toe, right heel and toe stand."""

    probability: Array  # (F, 4); about 1/2 where nothing is known
    is_known: NDArray[np.bool_]  # (F, 4)


def find_contacts(rays: Array, weight: Array, joints: Array, upward: Array, times: Array) -> Array:
    """Return the probabilities (F, 4) of `weigh_contacts`; NaN where nothing is known."""
    contacts = weigh_contacts(rays, weight, joints, upward, times)
    return np.where(contacts.is_known, contacts.probability, np.nan)


def weigh_contacts(rays: Array, weight: Array, joints: Array, upward: Array, times: Array) -> Contacts:
    """Return how probable it is that left heel and toe, right heel and toe stand.

    The camera does not move. In a layout without feet, both points of a foot are its ankle.

    Args:
        rays: (F, J, 2) x / z and y / z of the points of `BODY26` or `CMU15` in the camera; finite.
        weight: (F, J) scores in [0, 1]; 0 where a point was not seen.
        joints: (F, J', 3) m, the same joints of a solution in the camera's axes; NaN where there is none.
        upward: (3,) or (F, 3) unit vectors upwards in these axes; NaN where they are not known.
        times: (F,) s, increasing.
    """
    points, own = _choose_points(weight), _choose_points(np.isfinite(joints[..., 0]))
    feet = joints[:, own]
    speed = np.linalg.norm(_find_slopes(rays[:, points], weight[:, points], times), axis=-1) * feet[..., 2]
    heights = (feet * np.broadcast_to(upward, (len(times), 3))[:, None]).sum(axis=-1)
    above = np.nan_to_num(heights - heights.min(axis=1, keepdims=True))
    evidence = np.maximum(STANDING - (speed / SPEED_M_S) ** 2 - (above / HEIGHT_M) ** 2, -MOVING)
    steps = np.diff(times, append=2 * times[-1] - times[-2] if len(times) > 1 else times[-1] + MAX_STEP_S)
    evidence *= weight[:, points] * (np.minimum(steps, MAX_STEP_S) / EVIDENCE_S)[:, None]
    contact = _smooth(np.nan_to_num(evidence), np.exp(-steps / HOLD_S))
    is_unseen = ~np.isfinite(evidence) | (weight[:, points] <= 0)
    return Contacts(contact, ~is_unseen | (np.abs(contact - 0.5) >= MIN_KNOWN))


def _choose_points(known: NDArray[np.generic]) -> list[int]:
    """Return the indices of heels and toes, or of ankles instead of those that are never known (F, J)."""
    is_known = np.any(known, axis=0).tolist()
    pairs = zip(HEELS_AND_TOES, ANKLES, strict=True)
    return [point if point < len(is_known) and is_known[point] else ankle for point, ankle in pairs]


def _find_slopes(rays: Array, weight: Array, times: Array) -> Array:
    """Return d/dt (F, P, 2) of the rays, by straight lines; NaN where too few points are near."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else HALF_WINDOW_S
    reach = max(round(HALF_WINDOW_S / step), 1)
    frames, longest = np.arange(len(times)), 1.25 * max(HALF_WINDOW_S, step)
    count, first, second = np.zeros((3, *weight.shape))
    sums, products = np.zeros((2, *rays.shape))
    for shift in range(-reach, reach + 1):
        other = (frames + shift).clip(0, len(times) - 1)
        ago = times[other] - times
        is_near = (other == frames + shift) & (np.abs(ago) <= longest)
        seen, ago = (weight[other] > 0) * is_near[:, None], ago[:, None]
        moved = np.where(seen[..., None], rays[other] - rays, 0.0)
        count += seen
        first += seen * ago
        second += seen * ago * ago
        sums += moved
        products += ago[..., None] * moved
    spread = count * second - first * first
    is_enough = (weight > 0) & (count >= min(3, reach + 1)) & (spread > 0)
    slopes = count[..., None] * products - first[..., None] * sums
    return np.asarray(slopes / np.where(is_enough, spread, np.nan)[..., None])


def _smooth(evidence: Array, kept: Array) -> Array:
    """Return the probabilities (F, P) of the Markov chain; `kept` (F,) is k of the step to the next frame."""
    odds = np.empty((2, *evidence.shape))
    for direction, (e, k) in enumerate(((evidence, kept[:-1]), (evidence[::-1], kept[-2::-1]))):
        for point, factors in enumerate(np.exp(e).T.tolist()):
            before = []
            f = 1.0
            for factor, share in zip(factors, [1.0, *k.tolist()], strict=True):
                f = (f * (1 + share) + 1 - share) / (f * (1 - share) + 1 + share)
                before.append(f)
                f *= factor
            odds[direction, :, point] = before
    total = odds[0] * odds[1, ::-1] * np.exp(evidence)
    return np.asarray(total / (1 + total))
