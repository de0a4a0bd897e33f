# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The direction upwards that a pose shows: a body stands and walks with its centre of mass above its feet.

    u = normalise(c - f - b l n),    c = sum_j m_j P_j,    f = (ankle_l + ankle_r) / 2
    n = normalise(h x (c - f)),      h = hip_l - hip_r + shoulder_l - shoulder_r

with m_j the share of the body's mass that joint j carries (Winter, "Biomechanics and Motor Control of Human
Movement", 4th edition, table 4.1), l the length of a leg and the trunk, and n the direction ahead. Who sits shows
no direction upwards, nor does who kneels; whether a person stands shows in the straighter leg, by the flexion phi
of its hip or its knee, whichever is more bent:

    share = (PHI_1 - phi) / (PHI_1 - PHI_0), between 0 and 1

Who has both wrists above the head by more than H lengths of the trunk, along it, may hang, and does not stand.
Where hips and knees are not seen, the pose is one that usual people have, and no evidence.

Over the motion capture of training persons half of the angles between u and the vertical are below 3.2 degrees,
two thirds below 5, and 3 % above 27 (lying, sitting, tumbling).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import vertical as engine
from mocap_ros.skeleton import CMU15

# 1; b: how far ahead of the ankles the feet carry the body, over the length of a leg and the trunk: 7 cm at a
# stature of 1.7 m. 5 and 9 cm are worse on the training persons.
SUPPORT_AHEAD = 0.053
# Segments: upper and lower end, share of the body's mass, and position of the centre of mass between the ends.
_TRUNK_SEGMENTS = (('neck', 'pelvis', 0.497, 0.5), ('neck', 'head', 0.081, 1.0))
_LIMB_SEGMENTS = (
    ('shoulder', 'elbow', 0.028, 0.436),
    ('elbow', 'wrist', 0.022, 0.682),  # with the hand
    ('hip', 'knee', 0.100, 0.433),
    ('knee', 'ankle', 0.061, 0.606),  # with the foot
)
# PHI_0 and PHI_1, degrees: of those who walk or run, 95 of 100 frames are below the first; on a chair, hips are
# bent by 70 to 110, of which lifted poses show some 20 less where the thighs point towards the camera.
STANDING_FLEXION_DEG, SEATED_FLEXION_DEG = 40.0, 60.0
# 1; H: all who hang have their hands there, and 2 of 100 standing people of training persons
HANGING_SHARE = 0.3
MIN_LENGTH = 1e-9  # guards divisions by lengths, far below those of bodies in any unit


def _share_masses() -> Array:
    limbs = [(s + a, s + b, mass, share) for s in 'lr' for a, b, mass, share in _LIMB_SEGMENTS]
    masses = np.zeros(len(CMU15.joints))
    for upper, lower, mass, share in (*_TRUNK_SEGMENTS, *limbs):
        masses[CMU15.joints.index(upper)] += (1 - share) * mass
        masses[CMU15.joints.index(lower)] += share * mass
    return masses / masses.sum()


MASSES = _share_masses()  # (J,) of all joints of `CMU15`
_NECK, _PELVIS, _HEAD = (CMU15.joints.index(name) for name in ('neck', 'pelvis', 'head'))
_WRISTS = np.array([CMU15.joints.index(side + 'wrist') for side in 'lr'])
# (2, 4) indices of the joints of the left and of the right side
_SIDES = np.array([[CMU15.joints.index(s + n) for n in ('shoulder', 'hip', 'knee', 'ankle')] for s in 'lr'])
_THIGHS = _SIDES[:, 1:3].ravel()  # hips and knees
_NO_TURN = np.eye(3)[None]
_LIMITS = SUPPORT_AHEAD, HANGING_SHARE, STANDING_FLEXION_DEG, SEATED_FLEXION_DEG, MIN_LENGTH
_BODY = MASSES, _SIDES, _WRISTS, _NECK, _PELVIS, _HEAD, *_LIMITS


class Stances(NamedTuple):
    """What N poses show of the vertical."""

    upward: Array  # (N, 3) unit vectors upwards
    # (N,) shares to which the poses stand: 1 with a straight leg, 0 if both are bent as on a chair, and 0 if both
    # hands are high above the head
    standing: Array
    # (N,) shares to which that was seen, and not inferred: 1 with hips and knees, 0 with half of them or fewer
    seen: Array

    @staticmethod
    def of(joints: Array, cameras: Array = _NO_TURN, weight: Array | None = None) -> Stances:
        """Return what poses (N, J, 3) of `CMU15` or `BODY26` show.

        Rotations (N, 3, 3), or (1, 3, 3) for all, lead to the axes of the poses from those of the directions.
        Joints with a score (N, J) of 0 were not seen; without scores all were.
        """
        is_seen = np.ones((len(joints), 1)) if weight is None else weight[:, _THIGHS] > 0
        seen = np.maximum(2 * is_seen.mean(axis=1) - 1, 0.0)
        return Stances(*engine.find_stances(np.ascontiguousarray(joints), cameras, *_BODY), seen)
