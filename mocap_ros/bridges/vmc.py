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
from mocap_ros.messages.transforms import compute_links
from mocap_ros.units import NS_PER_S

FLOOR_NS = 2 * NS_PER_S  # over which the lowest joint shows the floor: longer than a jump, shorter than a climb
MIN_SINE = 0.1  # of the angle between up and where somebody looks, who else looks along the vertical
FRAME_RATE_HZ = 30.0  # a rate that an armature must have; of one frame it says nothing
OPTICAL_UP = np.array([0.0, -1.0, 0.0])  # upwards in an optical frame, if nothing else is known


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
            _, _, bodies = compute_links(people.joints[row : row + 1])
            self._ahead = np.nan_to_num(bodies[0][:, 0])
            self._origin = people.joints[row, people.skeleton.index('pelvis')]
            self._lowest.clear()
        row = people.numbers.index(self._number)
        axes = _find_axes(people, self._ahead)
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


def _find_axes(people: SeenPeople, ahead: Array) -> Array:
    """Return the axes of animation, left, up and ahead, in rows (3, 3) in the frame of the header."""
    is_known = people.vertical.any() and people.vertical_std <= MAX_CERTAIN_STD
    up = people.vertical / np.linalg.norm(people.vertical) if is_known else OPTICAL_UP
    ahead = ahead if np.linalg.norm(np.cross(up, ahead)) > MIN_SINE else np.roll(up, 1)
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    return np.stack([left, up, np.cross(left, up)])
