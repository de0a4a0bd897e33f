# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Orientations of the fifteen segments of a body, from the positions of the core joints.

A segment turns about its core joint: pelvis, torso (`neck`), head, arm, forearm and hand (shoulder, elbow, wrist),
thigh, shank and foot (hip, knee, ankle). In upright people with hanging arms all axes are x forward, y left, z up
(REP-103, REP-155). Up and left determine them:

    z = unit(up),    x = unit(left x z),    y = z x x

    segment                 up                                         left
    pelvis                  shoulders' middle - hips' middle           lhip - rhip
    torso                   neck - pelvis                              lshoulder - rshoulder
    head                    head - neck, then turned by `HEAD_REST`    y of the torso
    arm, thigh              from the lower to the upper joint          v
    forearm, shank          from the lower to the upper joint          y of the arm, y of the thigh
    hand, foot              the forearm and the shank turned by `REST`

    n = +-(u x l) + D f y_s,    v <- v' + (1 - e^(-h (1 + |n|^2 / W^2) / T)) (n - v')

u and l are unit vectors along upper and lower bone, y_s is y of the parent segment swung with the limb from rest
(f = 1 there, 0 opposite), v' the old v turned with the parent, h seconds ago: a limb that is straight for a short
time keeps its direction. Where feet are followed, y of thigh and shank is v + D_f y_foot
(`engine/extremities.pyx`).
"""

from __future__ import annotations

import math

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.skeleton import CMU15

SEGMENT_COUNT = len(CMU15.joints)  # segments, in the order of the core joints at which they begin
PART_SEGMENTS = np.array(
    [CMU15.index(n) for n in ('head', 'lankle', 'rankle', 'lwrist', 'rwrist')]
)  # head, feet, hands
HEAD, NECK, PELVIS = (CMU15.index(name) for name in ('head', 'neck', 'pelvis'))
LSHOULDER, RSHOULDER, LHIP, RHIP = (CMU15.index(name) for name in ('lshoulder', 'rshoulder', 'lhip', 'rhip'))
# Limbs: upper, middle and lower joint and parent segment.
LIMBS = np.array(
    [
        [CMU15.index(side + name) for name in joints] + [parent]
        for joints, parent in ((('shoulder', 'elbow', 'wrist'), NECK), (('hip', 'knee', 'ankle'), PELVIS))
        for side in 'lr'
    ]
)
# 1; forearms bend forwards and shanks backwards, so u x l points to the right in arms and to the left in legs
BENDS = np.array([-1.0, -1.0, 1.0, 1.0])


def rotation_about(axis: int, degrees: float) -> Array:
    """Return the rotation (3, 3) by an angle about the axis x, y or z (0, 1, 2)."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    out = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    out[first, first] = out[second, second] = cosine
    out[first, second], out[second, first] = -sine, sine
    return out


# Mean rotations of head, hands and feet against the bones that they hang on, in all motions of the training data
HEAD_REST = rotation_about(1, -13.0)
HAND_REST = np.stack([rotation_about(0, 16.0), rotation_about(0, -16.0)])
FOOT_REST = rotation_about(1, -19.0)
