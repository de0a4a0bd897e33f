# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The VMC protocol (Virtual Motion Capture): the pose of a humanoid as OSC messages over UDP.

Programs for avatars (VSeeFace, Warudo, Unity, Unreal, Blender with an add-on) receive it. The bones are those of
VRM 0.x. Each has a local rotation, from its T-pose, in which all bones have the axes of the world, and a place in
its parent, m. Unity's axes are left-handed, x to the right, y up and z forward, so that of the armature of
`armature`, right-handed with x to the left, x changes its sign, and of quaternions y and z:

    p' = (-x, y, z),    q' = (x, -y, -z, w)
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.formats.bvh import BvhMotion, compose_channels
from mocap_ros.formats.export.armature import CM_PER_M

_SIDES = ('Left', 'Right')
# Bone of the armature, and parent, of each bone of VRM; parents first.
BONES: dict[str, tuple[str, str]] = {
    'Hips': ('Hips', ''),
    'Spine': ('Spine', 'Hips'),
    'Chest': ('Spine2', 'Spine'),
    'Neck': ('Neck', 'Chest'),
    'Head': ('Head', 'Neck'),
    **{
        side + bone: (side + own, parent if parent in ('Chest', 'Hips') else side + parent)
        for side in _SIDES
        for bone, own, parent in (
            ('Shoulder', 'Shoulder', 'Chest'),
            ('UpperArm', 'Arm', 'Shoulder'),
            ('LowerArm', 'ForeArm', 'UpperArm'),
            ('Hand', 'Hand', 'LowerArm'),
            ('UpperLeg', 'UpLeg', 'Hips'),
            ('LowerLeg', 'Leg', 'UpperLeg'),
            ('Foot', 'Foot', 'LowerLeg'),
        )
    },
}
# What turns the armature's right-handed axes into Unity's
MIRROR_POSITION, MIRROR_QUATERNION = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])
IDENTITY = 0.0, 0.0, 0.0, 1.0  # quaternion x, y, z, w


class VmcPose(NamedTuple):
    """One frame: the names of bones, and of each position (3,) m in its parent and quaternion x, y, z, w (4,)."""

    names: tuple[str, ...]
    positions: Array  # (B, 3)
    quaternions: Array  # (B, 4)

    def list_messages(self, time_s: float) -> Iterator[tuple[str, list[str | float | int]]]:
        """Yield the addresses and the arguments of the messages of the frame."""
        yield '/VMC/Ext/OK', [1]
        yield '/VMC/Ext/T', [time_s]
        yield '/VMC/Ext/Root/Pos', ['root', 0.0, 0.0, 0.0, *IDENTITY]
        for name, position, quaternion in zip(self.names, self.positions, self.quaternions, strict=True):
            yield '/VMC/Ext/Bone/Pos', [name, *position.tolist(), *quaternion.tolist()]


def convert_armature(bvh: BvhMotion) -> Iterator[VmcPose]:
    """Yield the frames of an armature of `build_armature`."""
    from scipy.spatial.transform import Rotation

    frames, column = len(bvh.motion), 0
    turns: list[Rotation] = []  # of each node, from its T-pose
    rest = np.zeros((len(bvh.names), 3))  # m, places in the T-pose
    hips = np.zeros((frames, 3))
    for node, (parent, channels) in enumerate(zip(bvh.parents, bvh.channels, strict=True)):
        values = bvh.motion[:, column : column + len(channels)]
        column += len(channels)
        translation, turn = compose_channels(bvh.offsets[node], channels, values)
        turns.append(turn if parent < 0 else turns[parent] * turn)
        if parent < 0:
            hips = translation / CM_PER_M
        else:
            rest[node] = rest[parent] + bvh.offsets[node] / CM_PER_M
    at = {bone: bvh.names.index(own) for bone, (own, _) in BONES.items()}
    positions, quaternions = np.zeros((frames, len(BONES), 3)), np.zeros((frames, len(BONES), 4))
    for b, (bone, (_, parent_bone)) in enumerate(BONES.items()):
        above = turns[at[parent_bone]] if parent_bone else Rotation.identity(frames)
        quaternions[:, b] = MIRROR_QUATERNION * (above.inv() * turns[at[bone]]).as_quat()
        place = rest[at[bone]] - rest[at[parent_bone]] if parent_bone else hips
        positions[:, b] = MIRROR_POSITION * place
    for frame in range(frames):
        yield VmcPose(tuple(BONES), positions[frame], quaternions[frame])
