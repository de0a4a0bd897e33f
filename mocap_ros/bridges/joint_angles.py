# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/JointState: the joint angles of a result's `.angles.csv`, live, a message a person.

A message is what `.angles.csv` would say in its last row, if the recording ended now and had begun `PAST_NS` ago.
So the angles of bent limbs are those of the whole recording, but for whole turns. How a straight limb is turned
about itself is smoothed over the past alone, while a recording knows the future as well.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.bridges.ros4hri import JOINT_STATES
from mocap_ros.bridges.seen import SeenPeople
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, compute_joint_angles
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.transforms import FrameNames
from mocap_ros.units import NS_PER_S

ANGLES_TOPIC = 'joint_angles'
ANGLES = tuple(name for name in COORDINATES if name not in POSITIONS)
PAST_NS = NS_PER_S // 2  # several times the 0.1 s over which angles are smoothed
# Axes of biomechanics (x ahead, y up, z right) in those of `SeenPeople.find_world_axes`, in rows
TO_GROUND = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_ROWS = [COORDINATES.index(name) for name in ANGLES]


class _Past(NamedTuple):
    ahead: Array  # (3,) where the person looked first, in the frame of the header
    frames: dict[int, Array]  # joints (15, 3) m in that frame by stamp in ns, the oldest first


class AnglesConverter:
    """Converter of the people of successive messages; it remembers their names and their last frames."""

    def __init__(self) -> None:
        self._names = FrameNames()
        self._past: dict[str, _Past] = {}  # by id

    def convert(self, people: SeenPeople) -> list[tuple[str, str, Any]]:
        """Return topic, type and content of a message a person; its frame is the body, as of `/tf`."""
        names, now_ns, before = self._names.assign(people.ids), people.header.stamp_ns, self._past
        self._past, messages = {}, []
        for person_id, joints, heading in zip(people.ids, people.core, people.compute_headings(), strict=True):
            ahead, frames = before.get(person_id, _Past(heading, {}))
            recent = {stamp_ns: own for stamp_ns, own in frames.items() if 0 < now_ns - stamp_ns < PAST_NS}
            recent[now_ns] = joints
            self._past[person_id] = _Past(ahead, recent)
            ground = TO_GROUND @ people.find_world_axes(ahead)
            step_s = float(np.median(np.diff([*recent]))) / NS_PER_S if len(recent) > 1 else 1.0
            angles = compute_joint_angles(np.array([*recent.values()]) @ ground.T, 1 / step_s)[-1]
            header = Header(now_ns, f'body_{names[person_id]}')
            content = {'header': header, 'name': ANGLES, 'position': np.radians(angles[_ROWS])}
            messages.append((ANGLES_TOPIC, JOINT_STATES, content))
        return messages
