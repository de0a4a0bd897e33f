"""Joint positions as an armature for animation: bones of constant length, turned from a T-pose.

Where the body branches (pelvis, neck) each branch begins with a bone of no length that turns by itself, as in the
CMU database's own BVH files, whose names are used. So every bone points exactly where it should, and joints are
off by no more than the bone lengths varied.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.formats.mocap.bvh import END, POSITIONS, ROTATIONS, Bvh
from mocap_ros.geometry.rotations import rotation_to
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

CM = 100.0
LEFT, RIGHT, UP, DOWN = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)


class _Bone(NamedTuple):
    """A bone from joint `start` to joint `end` of the model, which points to `rest` in the T-pose.

    Without an end it is a joint that only turns: with what hangs on it where it branches, else not at all.
    """

    name: str
    parent: str
    start: str
    end: str = ''
    rest: tuple[float, float, float] = UP


BONES = (
    _Bone('Hips', '', 'pelvis'),
    _Bone('Spine', 'Hips', 'pelvis', 'neck', UP),
    _Bone('Neck', 'Spine', 'neck'),
    _Bone('Head', 'Neck', 'neck', 'head', UP),
    _Bone('LeftShoulder', 'Neck', 'neck', 'lshoulder', LEFT),
    _Bone('LeftArm', 'LeftShoulder', 'lshoulder', 'lelbow', LEFT),
    _Bone('LeftForeArm', 'LeftArm', 'lelbow', 'lwrist', LEFT),
    _Bone('LeftHand', 'LeftForeArm', 'lwrist'),
    _Bone('RightShoulder', 'Neck', 'neck', 'rshoulder', RIGHT),
    _Bone('RightArm', 'RightShoulder', 'rshoulder', 'relbow', RIGHT),
    _Bone('RightForeArm', 'RightArm', 'relbow', 'rwrist', RIGHT),
    _Bone('RightHand', 'RightForeArm', 'rwrist'),
    _Bone('LHipJoint', 'Hips', 'pelvis', 'lhip', LEFT),
    _Bone('LeftUpLeg', 'LHipJoint', 'lhip', 'lknee', DOWN),
    _Bone('LeftLeg', 'LeftUpLeg', 'lknee', 'lankle', DOWN),
    _Bone('LeftFoot', 'LeftLeg', 'lankle'),
    _Bone('RHipJoint', 'Hips', 'pelvis', 'rhip', RIGHT),
    _Bone('RightUpLeg', 'RHipJoint', 'rhip', 'rknee', DOWN),
    _Bone('RightLeg', 'RightUpLeg', 'rknee', 'rankle', DOWN),
    _Bone('RightFoot', 'RightLeg', 'rankle'),
)
BRANCHES = {
    'Hips': (('pelvis', 'neck', UP), ('pelvis', 'lhip', LEFT), ('pelvis', 'rhip', RIGHT)),
    'Neck': (('pelvis', 'neck', UP), ('neck', 'lshoulder', LEFT), ('neck', 'rshoulder', RIGHT)),
}


def armature(joints: Array, fps: float) -> Bvh:
    """The armature of a motion.

    Args:
        joints: (F, 15, 3) m, y up, of `skeleton.CMU15`.
        fps: frames a second.

    Returns:
        Offsets and positions in cm.
    """
    index = {name: i for i, name in enumerate(CMU15.joints)}
    bone_by_name = {bone.name: bone for bone in BONES}
    names, parents, offsets = [], [], []
    channels: list[tuple[str, ...]] = []
    columns = [joints[:, index['pelvis']] * CM]
    turned: dict[str, Rotation] = {}

    def vectors(start: str, end: str) -> Array:
        return np.asarray(joints[:, index[end]] - joints[:, index[start]])

    def offset_to_end(bone: _Bone) -> Array:
        if not bone.end:
            return np.zeros(3)
        return np.median(np.linalg.norm(vectors(bone.start, bone.end), axis=1)) * CM * np.array(bone.rest)

    for bone in BONES:
        above = bone_by_name.get(bone.parent)
        parent = turned[bone.parent] if above else Rotation.identity(len(joints))
        if bone.name in BRANCHES:
            turned[bone.name] = _towards_all([(vectors(a, b), rest) for a, b, rest in BRANCHES[bone.name]])
        elif bone.end:
            turned[bone.name] = parent * _swing(bone.rest, parent.inv().apply(vectors(bone.start, bone.end)))
        else:
            turned[bone.name] = parent
        columns.append(_angles(parent.inv() * turned[bone.name]))
        names.append(bone.name)
        parents.append(names.index(bone.parent) if above else -1)
        offsets.append(offset_to_end(above) if above and above.end == bone.start else np.zeros(3))
        channels.append(ROTATIONS if above else POSITIONS + ROTATIONS)
    for bone in BONES:
        if not any(other.parent == bone.name for other in BONES):
            names.append(bone.name + END)
            parents.append(names.index(bone.name))
            offsets.append(offset_to_end(bone))
            channels.append(())
    return Bvh(tuple(names), tuple(parents), np.array(offsets), tuple(channels), 1 / fps, np.hstack(columns))


def _angles(rotation: Rotation) -> Array:
    """(F, 3) degrees about the axes of `ROTATIONS`, without jumps by a full turn."""
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Gimbal lock', UserWarning)  # the angles are right, only not unique
        angles = rotation.as_euler(''.join(name[0] for name in ROTATIONS), degrees=True)
    return np.unwrap(angles, axis=0, period=360.0)


def _swing(rest: tuple[float, float, float], towards: Array) -> Rotation:
    """The smallest rotations that turn `rest` to the directions `towards` (F, 3)."""
    axis = np.cross(rest, towards)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, towards @ np.array(rest))
    across = np.roll(rest, 1)
    unit = np.where(sine[:, None] > 0, axis / np.maximum(sine, np.finfo(float).tiny)[:, None], across)
    return Rotation.from_rotvec(unit * angle[:, None])


def _towards_all(pairs: list[tuple[Array, tuple[float, float, float]]]) -> Rotation:
    """Rotations that turn several rest directions as nearly as can be to (F, 3) vectors."""
    lengths = [np.maximum(np.linalg.norm(v, axis=1, keepdims=True), np.finfo(float).tiny) for v, _ in pairs]
    target = np.stack([v / n for (v, _), n in zip(pairs, lengths, strict=True)], axis=1)
    rest = np.broadcast_to(np.array([rest for _, rest in pairs]), target.shape)
    return Rotation.from_matrix(rotation_to(rest, target))
