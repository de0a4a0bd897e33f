# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person of each message as a pose of the VMC protocol, for avatars that move live."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.bridges.seen import SeenPeople
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.vmc import VmcPose, convert_armature
from mocap_ros.geometry.level import MAX_CERTAIN_STD
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.units import NS_PER_S

FLOOR_NS = 2 * NS_PER_S  # over which the lowest joint shows the floor: longer than a jump, shorter than a climb
FRAME_RATE_HZ = 30.0  # a rate that an armature must have; of one frame it says nothing
# Directions in an optical frame, and in one whose z is up
OPTICAL_UP, OPTICAL_AHEAD, WORLD_AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
LEVEL_COSINE = 0.7  # of the angle from the vertical, 45 degrees: an axis ahead is less steep


class Avatar:
    """Sends the person who has been there longest, as `send` takes the pose and its time in s.

    Up is the vertical of the messages, or against y where it is not known; ahead is z of an optical frame, x of
    one whose z is up; the lowest joint of the last `FLOOR_NS` is on the floor.
    """

    def __init__(self, send: Callable[[VmcPose, float], None]) -> None:
        self._send = send
        self._number = -1  # of the person
        self._start_ns = 0
        self._lowest: deque[tuple[int, float]] = deque()  # stamp, and height of the lowest joint in m

    def show(self, people: SeenPeople) -> None:
        """Send the person's pose; nothing where nobody is."""
        if not len(people):
            return
        stamp_ns = people.header.stamp_ns
        if self._number not in people.numbers:
            self._number, self._start_ns = min(people.numbers), stamp_ns
            self._lowest.clear()
        row = people.numbers.index(self._number)
        axes = _find_axes(people)
        joints, orientation = people.joints[row] @ axes.T, people.joint_orientation[row]
        while self._lowest and not 0 <= stamp_ns - self._lowest[0][0] <= FLOOR_NS:
            self._lowest.popleft()
        self._lowest.append((stamp_ns, float(joints[:, 1].min())))
        joints[:, 1] -= min(height for _, height in self._lowest)
        turned = multiply_quaternions(np.array(quaternion_from_rotation(axes)), orientation[None])
        has_turns = np.isfinite(orientation).all()
        (pose,) = convert_armature(build_armature(joints[None], FRAME_RATE_HZ, turned if has_turns else None))
        self._send(pose, (stamp_ns - self._start_ns) / NS_PER_S)


def _find_axes(people: SeenPeople) -> Array:
    """Return the axes of animation, left, up and ahead, in rows (3, 3) in the frame of the header."""
    is_known = people.vertical.any() and people.vertical_std <= MAX_CERTAIN_STD
    up = people.vertical / np.linalg.norm(people.vertical) if is_known else OPTICAL_UP
    ahead = OPTICAL_AHEAD if abs(up @ OPTICAL_AHEAD) < LEVEL_COSINE else WORLD_AHEAD
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    return np.stack([left, up, np.cross(left, up)])
