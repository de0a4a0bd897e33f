"""Joint indices of the body's parts, for the synthesis of training examples."""

from __future__ import annotations

from mocap_ros.skeleton import CMU15

# Joints that move with a limb; the joint at which the limb begins is not among them.
LIMBS = {
    'larm': ('lelbow', 'lwrist'),
    'rarm': ('relbow', 'rwrist'),
    'lleg': ('lknee', 'lankle'),
    'rleg': ('rknee', 'rankle'),
    'lforearm': ('lwrist',),
    'rforearm': ('rwrist',),
    'lshank': ('lankle',),
    'rshank': ('rankle',),
    'head': ('head',),
}


def joint_indices(*names: str) -> list[int]:
    """Return the indices of joints in `skeleton.CMU15`."""
    return [CMU15.index(n) for n in names]


def limb_indices(name: str) -> list[int]:
    """Return the indices of the joints of a limb of `LIMBS`, or of both `arms` or both `legs`."""
    if name in ('legs', 'arms'):
        return limb_indices('l' + name[:-1]) + limb_indices('r' + name[:-1])
    return joint_indices(*LIMBS[name])
