# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint positions as an armature for animation: bones of constant length that are rotated from a T-pose.

A bone with the direction e in the T-pose has at every frame a rotation R and a constant length l:

    R e = (x_end - x_start) / |x_end - x_start|,    l = median over time of |x_end - x_start|.

How a bone is turned about e follows from the orientation Q of its segment (`solvers.extremities`), where it is
known: R = S Q Q_0^T, with Q_0 the axes of the segment in the T-pose and S the smallest rotation that fulfils the
formula above, since bone and segment differ a little. Else R is the smallest rotation from the parent bone.

The names are those of the CMU database's BVH files, with Spine2 and toes as other rigs have them. CMU's files have
bones of zero length where the body branches (pelvis, neck), so that every limb rotates by itself, and after wrists
and ankles, unless hands and toes are known.
Blender drops or lengthens bones of zero length, so here they are 1 cm long: where the body branches, a limb begins
1 cm beside the joint, and its first bone points from there to the limb's next joint. A joint is off by no more
than the variation of the lengths l of the bones between it and the pelvis.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.formats.bvh import END_SUFFIX, POSITION_CHANNELS, ROTATION_CHANNELS, BvhMotion, Node
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

CM_PER_M = 100.0  # a BVH file names no unit; files are written in cm, which most programs for animation expect
SHORT_BONE_M = 0.01  # m, of a bone without a second joint; can be seen in Blender, and hardly turns a limb
TINY = np.finfo(float).tiny  # guards divisions by the length of a vector

Direction = tuple[float, float, float]  # unit vector in the T-pose

# The directions of the body in the T-pose, which faces along z.
LEFT = (1.0, 0.0, 0.0)
RIGHT = (-1.0, 0.0, 0.0)
UP = (0.0, 1.0, 0.0)
DOWN = (0.0, -1.0, 0.0)
FORWARD = (0.0, 0.0, 1.0)


class _Bone(NamedTuple):
    name: str
    parent: str
    # Joint of the model at which the bone starts. If its parent starts at the same joint, the bone starts
    # `SHORT_BONE_M` from there, in its direction in the T-pose, and this point rotates with the parent
    start: str
    # Joint of the model at which the bone ends, empty for a bone of the length `SHORT_BONE_M`. Such a bone rotates
    # with its branches if it is in `BRANCHES`, else with its parent
    end: str = ''
    rest: Direction = UP
    segment: str = ''  # core joint about which the segment of this bone turns; empty for a bone without a segment


CHEST = 'chest'  # no joint of the model: the middle between pelvis and neck

# Name of a side in the names of bones, its letter in those of joints, and where it is in the T-pose.
_SIDES = (('Left', 'l', LEFT), ('Right', 'r', RIGHT))


def _list_arm(side: str, letter: str, out: Direction) -> tuple[_Bone, ...]:
    shoulder, elbow, wrist = letter + 'shoulder', letter + 'elbow', letter + 'wrist'
    return (
        _Bone(f'{side}Shoulder', 'Neck', 'neck', shoulder, out),
        _Bone(f'{side}Arm', f'{side}Shoulder', shoulder, elbow, out, shoulder),
        _Bone(f'{side}ForeArm', f'{side}Arm', elbow, wrist, out, elbow),
        _Bone(f'{side}Hand', f'{side}ForeArm', wrist, '', out),
    )


def _list_leg(side: str, letter: str, out: Direction) -> tuple[_Bone, ...]:
    hip, knee, ankle = letter + 'hip', letter + 'knee', letter + 'ankle'
    return (
        _Bone(f'{letter.upper()}HipJoint', 'Hips', 'pelvis', hip, out),
        _Bone(f'{side}UpLeg', f'{letter.upper()}HipJoint', hip, knee, DOWN, hip),
        _Bone(f'{side}Leg', f'{side}UpLeg', knee, ankle, DOWN, knee),
        _Bone(f'{side}Foot', f'{side}Leg', ankle, '', FORWARD),
        _Bone(f'{side}Toe', f'{side}Foot', letter + 'toe', '', FORWARD),  # where toes are known
    )


# The bones, parents first.
BONES = (
    _Bone('Hips', '', 'pelvis'),
    _Bone('Spine', 'Hips', 'pelvis', CHEST, UP, 'neck'),
    _Bone('Spine2', 'Spine', CHEST, 'neck', UP, 'neck'),
    _Bone('Neck', 'Spine2', 'neck'),
    _Bone('Head', 'Neck', 'neck', 'head', UP, 'head'),
    *(bone for side in _SIDES for bone in _list_arm(*side)),
    *(bone for side in _SIDES for bone in _list_leg(*side)),
)

# What changes of the bones that reach to hands and toes, where these are known.
TOE_DROP_RAD = 0.262  # rad, 15 degrees; by so much the line from ankle to toe drops where a foot stands flat
_TOE_REST: Direction = (0.0, -math.sin(TOE_DROP_RAD), math.cos(TOE_DROP_RAD))
_OUTER_ENDS: dict[str, dict[str, Any]] = {
    f'{side}{bone}': {'end': letter + end, 'rest': rest, 'segment': letter + segment}
    for side, letter, out in _SIDES
    for bone, end, rest, segment in (('Hand', 'hand', out, 'wrist'), ('Foot', 'toe', _TOE_REST, 'ankle'))
}

# Axes forward, left and up of the segments in the T-pose, in columns; those of an arm by its bones' rest
_UPRIGHT_AXES = np.array([FORWARD, LEFT, UP]).T
_ARM_AXES = {LEFT: np.array([FORWARD, UP, RIGHT]).T, RIGHT: np.array([FORWARD, DOWN, LEFT]).T}

# For a bone where the body branches: start, end and rest direction of the vectors that determine its rotation.
BRANCHES = {
    'Hips': (('pelvis', 'neck', UP), ('pelvis', 'lhip', LEFT), ('pelvis', 'rhip', RIGHT)),
    'Neck': (('pelvis', 'neck', UP), ('neck', 'lshoulder', LEFT), ('neck', 'rshoulder', RIGHT)),
}


def build_armature(joints: Array, fps: float, orientation: Array | None = None) -> BvhMotion:
    """Return the armature of a motion, with offsets and positions in cm.

    Joints (F, J, 3) are in m, y up, in the order of `skeleton.CMU15` or `skeleton.BODY26`; orientations (F, J, 4)
    are quaternions x, y, z, w of the segments in the same frame, None if unknown.
    """
    from scipy.spatial.transform import Rotation

    has_extremities = joints.shape[1] > CORE_COUNT
    index = {name: i for i, name in enumerate((*(BODY26 if has_extremities else CMU15).joints, CHEST))}
    bones = [bone for bone in BONES if bone.start in index]
    if has_extremities:
        bones = [bone._replace(**_OUTER_ENDS.get(bone.name, {})) for bone in bones]
    chest = joints[:, [index['pelvis'], index['neck']]].mean(axis=1, keepdims=True)
    joints = np.concatenate([joints, chest], axis=1)
    bone_by_name = {bone.name: bone for bone in bones}
    number = {bone.name: i for i, bone in enumerate(bones)}
    nodes: list[Node] = []
    columns = [joints[:, index['pelvis']] * CM_PER_M]
    global_rotation: dict[str, Rotation] = {}
    end_offset: dict[str, Array] = {}  # m, from the start to the end of a bone in the T-pose
    for bone in bones:
        parent = bone_by_name.get(bone.parent)
        parent_rotation = global_rotation[bone.parent] if parent else Rotation.identity(len(joints))
        offset = end_offset[bone.parent] if parent else np.zeros(3)
        start = joints[:, index[bone.start]]
        if parent and parent.start == bone.start:
            offset = SHORT_BONE_M * np.array(bone.rest)
            start = start + parent_rotation.apply(offset)
        length = SHORT_BONE_M
        if bone.name in BRANCHES:
            rotation = _fit_rotations(
                [(joints[:, index[tip]] - joints[:, index[base]], rest) for base, tip, rest in BRANCHES[bone.name]]
            )
        elif bone.end:
            vectors = joints[:, index[bone.end]] - start
            length = max(float(np.median(np.linalg.norm(vectors, axis=1))), SHORT_BONE_M)
            if bone.segment and orientation is not None:
                axes = _ARM_AXES.get(bone.rest, _UPRIGHT_AXES)
                turned = Rotation.from_quat(orientation[:, index[bone.segment]])
                near = turned * Rotation.from_matrix(axes).inv()
            else:
                near = parent_rotation
            rotation = near * _shortest_rotations(bone.rest, near.inv().apply(vectors))
        else:
            rotation = parent_rotation
        global_rotation[bone.name] = rotation
        end_offset[bone.name] = length * np.array(bone.rest)
        columns.append(_compute_channel_angles(parent_rotation.inv() * rotation))
        channels = ROTATION_CHANNELS if parent else POSITION_CHANNELS + ROTATION_CHANNELS
        nodes.append(Node(bone.name, number.get(bone.parent, -1), offset * CM_PER_M, channels))
    for bone in bones:
        has_children = any(child.parent == bone.name for child in bones)
        if not has_children:
            nodes.append(Node(bone.name + END_SUFFIX, number[bone.name], end_offset[bone.name] * CM_PER_M))
    return BvhMotion.from_nodes(nodes, 1 / fps, np.hstack(columns))


def _compute_channel_angles(rotation: Rotation) -> Array:
    """Return (F, 3) angles in degrees about the axes of `ROTATION_CHANNELS`, without jumps by a full turn."""
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Gimbal lock', UserWarning)  # the angles are correct, but not unique
        angles = rotation.as_euler(''.join(name[0] for name in ROTATION_CHANNELS), degrees=True)
    return np.unwrap(angles, axis=0, period=360.0)


def _shortest_rotations(rest: Direction, directions: Array) -> Rotation:
    """Return the smallest rotations that take `rest` to the directions of vectors (F, 3)."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(rest, directions)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, directions @ np.array(rest))
    perpendicular = np.roll(rest, 1)  # the axis of a half turn, whose cross product is zero
    unit_axis = np.where(sine[:, None] > 0, axis / np.maximum(sine, TINY)[:, None], perpendicular)
    return Rotation.from_rotvec(unit_axis * angle[:, None])


def _fit_rotations(pairs: list[tuple[Array, Direction]]) -> Rotation:
    """Return the rotations that take several rest directions to those of vectors (F, 3), by least squares."""
    from scipy.spatial.transform import Rotation

    lengths = [np.maximum(np.linalg.norm(v, axis=1, keepdims=True), TINY) for v, _ in pairs]
    target = np.stack([v / n for (v, _), n in zip(pairs, lengths, strict=True)], axis=1)
    rest = np.broadcast_to(np.array([rest for _, rest in pairs]), target.shape)
    return Rotation.from_matrix(fit_rotation(rest, target))
