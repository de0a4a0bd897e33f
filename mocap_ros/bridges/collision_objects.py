# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""moveit_msgs/CollisionObject: each person as an object of MoveIt's planning scene, made of cylinders.

A capsule between two points at the distance l with the radius r lies in the cylinder of the length l + 2 r and the
radius r about the same axis; planning scenes have no capsules.
"""

from __future__ import annotations

from typing import Any

from mocap_ros.bridges.capsules import compute_capsules, find_axis_poses
from mocap_ros.bridges.seen import SeenPeople
from mocap_ros.geometry.rigid_transform import SAME_POSE

Content = dict[str, Any] | bytes  # of a message: plain values of some of its fields, or CDR
ID_PREFIX = 'person_'  # of the names of the objects in the planning scene

# Values of moveit_msgs/CollisionObject.operation and of shape_msgs/SolidPrimitive.type.
ADD = 0
REMOVE = 1
CYLINDER = 3


def convert_collision_objects(people: SeenPeople, before: SeenPeople) -> list[Content]:
    """Return a message for each who is gone since the message before, which removes them, and for each person."""
    header = people.header
    start, end, radius = compute_capsules(people.joints, people.joint_std, people.root_covariance, people.skeleton)
    length, poses = find_axis_poses(start, end)
    height = length + 2 * radius
    common: dict[str, Any] = {'header': header, 'pose': SAME_POSE, 'type': ('person', '')}
    removed: list[Content] = [
        {**common, 'id': ID_PREFIX + person_id, 'operation': REMOVE}
        for person_id in before.ids
        if person_id not in people.ids
    ]
    return removed + [
        {
            **common,
            'id': ID_PREFIX + person_id,
            'primitives': [
                {'type': CYLINDER, 'dimensions': size} for size in zip(height[n], radius[n], strict=True)
            ],
            'primitive_poses': poses[n],
            'operation': ADD,
        }
        for n, person_id in enumerate(people.ids)
    ]
