# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parts of bodies, and postures that motion capture hardly holds.

    trunk: R_y(p)      thigh: (cos d sin a, +-sin d, -cos d cos a)      shank: the same with b and -d / 2

People bend over, crouch, kneel, sit on the heels and go on all fours. p, a, b and d are angles in the body frame
(x forward, y left, z up): p leans forward, a and b are 0 where the limb hangs down and positive where its end is
in front, d spreads the knees. They change slowly over the history. A posture replaces the directions of the legs,
and on all fours of the arms and hands; trunk and head lean as a whole, and the feet turn about the axis y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_ros.models.lifter_input import HISTORY_SLOTS_S
from mocap_ros.skeleton import BODY26
from mocap_ros.training.random_arrays import Array, RandomArrays

Range = tuple[float, float]

FACE = ('nose', 'leye', 'reye', 'lear', 'rear')
FEET = ('ltoe', 'rtoe', 'lheel', 'rheel')
HANDS = ('lhand', 'rhand')

# Joints that move with a limb; the joint at which the limb begins is not among them.
LIMBS = {
    'larm': ('lelbow', 'lwrist', 'lhand'),
    'rarm': ('relbow', 'rwrist', 'rhand'),
    'lleg': ('lknee', 'lankle', 'ltoe', 'lheel'),
    'rleg': ('rknee', 'rankle', 'rtoe', 'rheel'),
    'lforearm': ('lwrist', 'lhand'),
    'rforearm': ('rwrist', 'rhand'),
    'lshank': ('lankle', 'ltoe', 'lheel'),
    'rshank': ('rankle', 'rtoe', 'rheel'),
    'lfoot': ('ltoe', 'lheel'),
    'rfoot': ('rtoe', 'rheel'),
    'lhand': ('lhand',),
    'rhand': ('rhand',),
    'head': ('head', *FACE),
}


def joint_indices(*names: str) -> list[int]:
    """Return the indices of joints in `skeleton.BODY26`."""
    return [BODY26.index(n) for n in names]


def limb_indices(name: str) -> list[int]:
    """Return the indices of the joints of a limb of `LIMBS`, or of both `arms` or both `legs`."""
    if name in ('legs', 'arms'):
        return limb_indices('l' + name[:-1]) + limb_indices('r' + name[:-1])
    return joint_indices(*LIMBS[name])


@dataclass(frozen=True)
class _Posture:
    """One kind of posture, with its share of the examples and ranges of angles in degrees.

    Attributes:
        share: share of the examples.
        trunk: the trunk's lean p.
        thigh: the angle a.
        shank: the angle b.
        foot: by which the foot is turned toes downwards from how it stood.
        on_hands: whether the arms support the body.
    """

    share: float
    trunk: Range
    thigh: Range
    shank: Range
    foot: Range
    on_hands: bool = False


POSTURES = (
    # bent over, knees nearly straight
    _Posture(0.02, trunk=(35, 110), thigh=(-20, 30), shank=(-35, 5), foot=(-15, 20)),
    # crouching
    _Posture(0.02, trunk=(0, 70), thigh=(50, 125), shank=(-55, 5), foot=(-15, 50)),
    # kneeling upright
    _Posture(0.02, trunk=(-10, 35), thigh=(-20, 30), shank=(-105, -70), foot=(60, 190)),
    # sitting on the heels
    _Posture(0.015, trunk=(-10, 50), thigh=(55, 100), shank=(-110, -75), foot=(80, 190)),
    # on all fours
    _Posture(0.015, trunk=(55, 105), thigh=(-25, 35), shank=(-110, -70), foot=(60, 190), on_hands=True),
)
SIDE_STD_RAD = 0.2  # rad, standard deviation of each component by which the two sides differ
SPREAD_RANGE_RAD = (-0.1, 0.5)  # rad, by which knees are apart
HANGING_ARMS_SHARE = 0.5  # share of the others whose arms keep their directions instead of leaning with the trunk
FLAT_HAND_RAD = 1.4  # rad, from the forearm of a person on all fours to the hand, which lies flat on the floor
MOVING_SHARE = 0.5  # share of the examples that move into or out of the posture
RATE_STD_RAD_S = 0.5  # rad/s, standard deviation of the rate of each angle in these

_TRUNK = joint_indices('head', 'neck', 'lshoulder', 'rshoulder', 'lhip', 'rhip', *FACE)
_ARMS = joint_indices('lelbow', 'lwrist', 'relbow', 'rwrist', *HANDS)
_FEET = joint_indices(*FEET)


def take_postures(vectors: Array, random: RandomArrays) -> Array:
    """Return bone vectors (N, T, J, 3) in m of bodies that face +x, some of them in postures of `POSTURES`."""
    number = np.searchsorted(np.cumsum([p.share for p in POSTURES]), random.rng.random(len(vectors)), side='right')
    out = vectors.copy()
    for i, posture in enumerate(POSTURES):
        chosen = np.flatnonzero(number == i)
        if len(chosen):
            out[chosen] = _take_posture(vectors[chosen], posture, random)
    return out


def _take_posture(vectors: Array, posture: _Posture, random: RandomArrays) -> Array:
    """Return the bone vectors (N, T, J, 3) with the angles of one posture."""
    count = len(vectors)
    out = vectors.copy()
    lean = _draw_angles(count, posture.trunk, random)
    out[:, :, _TRUNK] = _lean_forward(vectors[:, :, _TRUNK], lean)
    leaning_arms = _lean_forward(vectors[:, :, _ARMS], lean)
    hangs = random.chance(count, HANGING_ARMS_SHARE, axes=3)
    out[:, :, _ARMS] = np.where(hangs, vectors[:, :, _ARMS], leaning_arms)
    thigh, shank = (_draw_angles(count, angles, random) for angles in (posture.thigh, posture.shank))
    spread = random.uniform(*SPREAD_RANGE_RAD, count, 1)
    support = _draw_angles(count, (-25, 25), random)
    out[:, :, _FEET] = _lean_forward(vectors[:, :, _FEET], _draw_angles(count, posture.foot, random))
    for side, outwards in (('l', 1), ('r', -1)):
        limbs: list[tuple[str, Array, Array]] = [
            ('knee', thigh, spread),
            ('ankle', shank, -np.float32(0.5) * spread),
        ]
        if posture.on_hands:
            straight = np.zeros_like(spread)
            flat = support + np.float32(FLAT_HAND_RAD)
            limbs += [('elbow', support, straight), ('wrist', support, straight), ('hand', flat, straight)]
        for joint, angle, apart in limbs:
            (index,) = joint_indices(side + joint)
            length = np.linalg.norm(vectors[:, :, index], axis=-1, keepdims=True)
            a = angle + SIDE_STD_RAD * random.normal(count, 1)
            d = apart + SIDE_STD_RAD * random.normal(count, 1)
            aside = np.broadcast_to(outwards * np.sin(d), a.shape)
            direction = np.stack([np.cos(d) * np.sin(a), aside, -np.cos(d) * np.cos(a)], axis=-1)
            out[:, :, index] = length * direction
    return out


def _draw_angles(count: int, degrees: Range, random: RandomArrays) -> Array:
    """Return angles (N, T) in rad, the newest within a range in degrees."""
    newest = np.radians(random.uniform(*degrees, count, 1))
    rate = random.choose(count, MOVING_SHARE, RATE_STD_RAD_S, 0, axes=1) * random.normal(count, 1)
    return np.asarray(newest - rate * HISTORY_SLOTS_S.astype(np.float32))


def _lean_forward(vectors: Array, angle: Array) -> Array:
    """Rotate vectors (N, T, M, 3) by angles (N, T) about y."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x + s * z, y, c * z - s * x], axis=-1)
