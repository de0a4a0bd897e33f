# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The content of a BVH file: a hierarchy of bones of constant length, and its joint angles over time.

The position x_n and rotation R_n of node n with parent p are (forward kinematics)

    x_n = x_p + R_p t_n,    R_n = R_p L_n,

where t_n is the offset of the node, in which a position channel replaces its coordinate, and L_n is the product of
the rotations about the axes of the rotation channels, in the order of the channels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

END_SUFFIX = '_end'  # follows the joint's name in the name of its end site, which has no name in a file

POSITION_CHANNELS = ('Xposition', 'Yposition', 'Zposition')
ROTATION_CHANNELS = ('Zrotation', 'Yrotation', 'Xrotation')  # in the order in which BVH files are written


@dataclass(frozen=True, eq=False)
class BvhMotion:
    """A hierarchy of joints and its motion.

    Attributes:
        names: (N,) names of the joints and end sites, parents first; an end site has its joint's name and
            `END_SUFFIX`.
        parents: (N,) index of each node's parent, -1 for the root.
        offsets: (N, 3) offset from the parent, in the file's unit of length.
        channels: (N,) names of each node's channels, in the order of their values.
        frame_time: time between frames in s.
        motion: (F, C) values of all channels, in the file's unit of length and in degrees.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    channels: tuple[tuple[str, ...], ...]
    frame_time: float
    motion: Array

    def compute_positions(self) -> Array:
        """Compute the positions (F, N, 3) of all nodes in the file's own frame and unit (forward kinematics)."""
        frames = len(self.motion)
        position = np.zeros((frames, len(self.names), 3))
        rotation: list[Rotation] = []
        first_column = 0
        for node, (parent, channels) in enumerate(zip(self.parents, self.channels, strict=True)):
            values = self.motion[:, first_column : first_column + len(channels)]
            first_column += len(channels)
            translation = np.tile(self.offsets[node], (frames, 1))
            local_rotation = Rotation.identity(frames)
            for column, name in enumerate(channels):
                if name in POSITION_CHANNELS:
                    translation[:, POSITION_CHANNELS.index(name)] = values[:, column]
                else:
                    axis = name[0]
                    turn = Rotation.from_euler(axis, values[:, [column]], degrees=True)
                    local_rotation = local_rotation * turn
            if parent < 0:
                position[:, node] = translation
                rotation.append(local_rotation)
            else:
                position[:, node] = position[:, parent] + rotation[parent].apply(translation)
                rotation.append(rotation[parent] * local_rotation)
        return position
