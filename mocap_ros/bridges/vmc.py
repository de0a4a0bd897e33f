# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person of each message as a pose of the VMC protocol, for avatars that move live."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from mocap_ros.bridges.seen import SeenPeople
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.vmc import VmcPose, convert_armature
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.units import NS_PER_S

FLOOR_NS = 2 * NS_PER_S  # over which the lowest joint shows the floor: longer than a jump, shorter than a climb
FRAME_RATE_HZ = 30.0  # a rate that an armature must have; of one frame it says nothing


class Avatar:
    """Sends the person who has been there longest, as `send` takes the pose and its time in s.

    As in a result, ahead is where the person looks first, and the origin is below the first pelvis. Up is the
    vertical of the messages, or against y where it is not known. The lowest joint of the last `FLOOR_NS` is on the
    floor.
    """

    def __init__(self, send: Callable[[VmcPose, float], None]) -> None:
        self._send = send
        self._number = -1  # of the person
        self._start_ns = 0
        self._ahead = self._origin = np.zeros(3)  # in the frame of the header
        self._lowest: deque[tuple[int, float]] = deque()  # stamp, and height of the lowest joint in m

    def show(self, people: SeenPeople) -> None:
        """Send the person's pose; nothing where nobody is."""
        if not len(people):
            return
        stamp_ns = people.header.stamp_ns
        if self._number not in people.numbers:
            self._number, self._start_ns = min(people.numbers), stamp_ns
            row = people.numbers.index(self._number)
            self._ahead = people.compute_headings()[row]
            self._origin = people.joints[row, people.skeleton.index('pelvis')]
            self._lowest.clear()
        row = people.numbers.index(self._number)
        axes = people.find_world_axes(self._ahead)
        joints = (people.joints[row] - self._origin) @ axes.T
        while self._lowest and not 0 <= stamp_ns - self._lowest[0][0] <= FLOOR_NS:
            self._lowest.popleft()
        self._lowest.append((stamp_ns, float(joints[:, 1].min())))
        joints[:, 1] -= min(height for _, height in self._lowest)
        orientation = people.joint_orientation[row]
        turned = None
        if (np.linalg.norm(orientation, axis=1) > 0).all():  # also false for those that are not known
            turned = multiply_quaternions(np.array(quaternion_from_rotation(axes)), orientation[None])
        (pose,) = convert_armature(build_armature(joints[None], FRAME_RATE_HZ, turned))
        self._send(pose, (stamp_ns - self._start_ns) / NS_PER_S)
