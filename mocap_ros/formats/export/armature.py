"""Joint positions as an armature for animation: bones of constant length that are rotated from a T-pose.

A bone with the direction e in the T-pose has at every frame a rotation R and a constant length l:

    R e = (x_end - x_start) / |x_end - x_start|,    l = median over time of |x_end - x_start|.

The names are those of the CMU database's BVH files. As in these files, each limb begins with a bone of zero length
where the body branches (pelvis, neck), so that every limb rotates by itself. Every bone therefore has exactly the
direction that the joints give it. A joint is off by no more than the variation of the bone lengths between it and
the pelvis.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.formats.bvh_motion import END_SUFFIX, POSITION_CHANNELS, ROTATION_CHANNELS, BvhMotion
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

CM_PER_M = 100.0  # BVH files are written in cm
TINY = np.finfo(float).tiny  # guards divisions by the length of a vector

Direction = tuple[float, float, float]  # unit vector in the T-pose

# The directions of the body in the T-pose, which faces along z.
LEFT = (1.0, 0.0, 0.0)
RIGHT = (-1.0, 0.0, 0.0)
UP = (0.0, 1.0, 0.0)
DOWN = (0.0, -1.0, 0.0)


class _Bone(NamedTuple):
    """A bone of the armature.

    Attributes:
        name: name of the bone.
        parent: name of the parent bone, empty for the root.
        start: joint of the model at which the bone starts.
        end: joint of the model at which the bone ends, empty for a bone of zero length. Such a bone rotates with
            its branches if it is in `BRANCHES`, else with its parent.
        rest: direction in the T-pose.
    """

    name: str
    parent: str
    start: str
    end: str = ''
    rest: Direction = UP


# The bones, parents first.
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

# For a bone where the body branches: start, end and rest direction of the vectors that determine its rotation.
BRANCHES = {
    'Hips': (('pelvis', 'neck', UP), ('pelvis', 'lhip', LEFT), ('pelvis', 'rhip', RIGHT)),
    'Neck': (('pelvis', 'neck', UP), ('neck', 'lshoulder', LEFT), ('neck', 'rshoulder', RIGHT)),
}


def build_armature(joints: Array, fps: float) -> BvhMotion:
    """Build the armature of a motion.

    Args:
        joints: (F, 15, 3) m, y up, in the order of `skeleton.CMU15`.
        fps: frame rate in Hz.

    Returns:
        The armature and its motion, with offsets and positions in cm.
    """
    index = {name: i for i, name in enumerate(CMU15.joints)}

    def compute_vectors(start: str, end: str) -> Array:
        return np.asarray(joints[:, index[end]] - joints[:, index[start]])

    def compute_end_offset(bone: _Bone) -> Array:
        """Compute the vector (3,) in cm from the start to the end of a bone in the T-pose."""
        if not bone.end:
            return np.zeros(3)
        length = np.median(np.linalg.norm(compute_vectors(bone.start, bone.end), axis=1))
        return length * CM_PER_M * np.array(bone.rest)

    bone_by_name = {bone.name: bone for bone in BONES}
    names, parents, offsets = [], [], []
    channels: list[tuple[str, ...]] = []
    columns = [joints[:, index['pelvis']] * CM_PER_M]
    global_rotation: dict[str, Rotation] = {}
    for bone in BONES:
        parent = bone_by_name.get(bone.parent)
        parent_rotation = global_rotation[bone.parent] if parent else Rotation.identity(len(joints))
        if bone.name in BRANCHES:
            branches = [(compute_vectors(start, end), rest) for start, end, rest in BRANCHES[bone.name]]
            rotation = _fit_rotations(branches)
        elif bone.end:
            directions = parent_rotation.inv().apply(compute_vectors(bone.start, bone.end))
            rotation = parent_rotation * _shortest_rotations(bone.rest, directions)
        else:
            rotation = parent_rotation
        global_rotation[bone.name] = rotation
        columns.append(_compute_channel_angles(parent_rotation.inv() * rotation))
        names.append(bone.name)
        parents.append(names.index(bone.parent) if parent else -1)
        starts_at_parent_end = parent is not None and parent.end == bone.start
        offsets.append(compute_end_offset(parent) if parent and starts_at_parent_end else np.zeros(3))
        channels.append(ROTATION_CHANNELS if parent else POSITION_CHANNELS + ROTATION_CHANNELS)
    for bone in BONES:
        has_children = any(child.parent == bone.name for child in BONES)
        if not has_children:
            names.append(bone.name + END_SUFFIX)
            parents.append(names.index(bone.name))
            offsets.append(compute_end_offset(bone))
            channels.append(())
    return BvhMotion(tuple(names), tuple(parents), np.array(offsets), tuple(channels), 1 / fps, np.hstack(columns))


def _compute_channel_angles(rotation: Rotation) -> Array:
    """Return (F, 3) angles in degrees about the axes of `ROTATION_CHANNELS`, without jumps by a full turn."""
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Gimbal lock', UserWarning)  # the angles are correct, but not unique
        angles = rotation.as_euler(''.join(name[0] for name in ROTATION_CHANNELS), degrees=True)
    return np.unwrap(angles, axis=0, period=360.0)


def _shortest_rotations(rest: Direction, directions: Array) -> Rotation:
    """Return the smallest rotations that take `rest` to the directions of vectors (F, 3)."""
    axis = np.cross(rest, directions)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, directions @ np.array(rest))
    perpendicular = np.roll(rest, 1)  # the axis of a half turn, whose cross product is zero
    unit_axis = np.where(sine[:, None] > 0, axis / np.maximum(sine, TINY)[:, None], perpendicular)
    return Rotation.from_rotvec(unit_axis * angle[:, None])


def _fit_rotations(pairs: list[tuple[Array, Direction]]) -> Rotation:
    """Return the rotations that take several rest directions to those of vectors (F, 3), by least squares."""
    lengths = [np.maximum(np.linalg.norm(v, axis=1, keepdims=True), TINY) for v, _ in pairs]
    target = np.stack([v / n for (v, _), n in zip(pairs, lengths, strict=True)], axis=1)
    rest = np.broadcast_to(np.array([rest for _, rest in pairs]), target.shape)
    return Rotation.from_matrix(fit_rotation(rest, target))
