# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint indices of the body's parts, for the synthesis of training examples."""

from __future__ import annotations

from mocap_ros.skeleton import BODY26

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
