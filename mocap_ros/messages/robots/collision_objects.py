# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""moveit_msgs/CollisionObject: each person as an object of MoveIt's planning scene, made of cylinders.

A capsule between two places at the distance l with the radius r lies in the cylinder of the length l + 2 r and the
radius r about the same axis; planning scenes have no capsules.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mocap_ros.geometry.rigid_transform import SAME_POSE
from mocap_ros.messages.cdr import Array, Header
from mocap_ros.messages.robots.capsules import compute_all_capsules
from mocap_ros.messages.stacked_people import StackedPeople, stack_people
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, SeriesTemplate, TemplateWriter
from mocap_ros.people import Person3D

ID_PREFIX = 'person_'  # of the names of the objects in the planning scene

# Values of moveit_msgs/CollisionObject.operation and of shape_msgs/SolidPrimitive.type.
ADD = 0
REMOVE = 1
CYLINDER = 3

TYPE_KEY = 'person'  # CollisionObject.type.key
EMPTY_SEQUENCES = (
    6  # fields between the shapes and the operation: meshes, planes and subframes, each with its poses
)
MIN_LENGTH_M = 1e-6  # m; between places that are nearer to each other there is no axis
MIN_QUATERNION = 1e-6  # 1; length of the quaternion before it is made 1, of an axis that points down
_POSE = struct.Struct('<7d')


class CollisionObjectEncoder:
    """Encoder of the successive collision objects; it remembers who was there, to remove them from the scene."""

    def __init__(self) -> None:
        self._present: dict[str, None] = {}  # ids, in the order in which they came

    def encode_update(self, header: Header, people: Sequence[Person3D]) -> list[bytes]:
        """Encode a message for each person, and one for each who is gone.

        Args:
            header: time of the image, and the frame in which the people are.
            people: the people.
        """
        ids = {person.id: None for person in people}
        gone = [person_id for person_id in self._present if person_id not in ids]
        self._present = ids
        removed = _lay_out(header.frame_id, tuple(gone), REMOVE).fill(header.stamp_ns)
        if not people:
            return removed
        stacked = stack_people(people)
        _, poses = stacked.share(find_capsule_poses)
        template = _lay_out(header.frame_id, stacked.ids, ADD, poses.shape[1])
        return removed + template.fill(header.stamp_ns, dimensions=_measure_cylinders(stacked), poses=poses)

    def encode_clear(self, header: Header) -> list[bytes]:
        """Encode a message for each person who was there, which removes them, and forget all people."""
        return self.encode_update(header, [])


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, ids: tuple[str, ...], operation: int, shapes: int = 0) -> SeriesTemplate:
    """Return the template of the object of each person."""
    writer = TemplateWriter()
    for person_id in ids:
        writer.add_stamped(frame_id)
        writer.add(8, _POSE.pack(*SAME_POSE))
        for text in (ID_PREFIX + person_id, TYPE_KEY, ''):
            writer.add_text(text)
        writer.add_count(shapes)
        for _ in range(shapes):
            writer.add(1, bytes([CYLINDER]))
            writer.add_number_sequence('dimensions', DOUBLE, 2)
            writer.add_count(0)  # points of the polygon of a prism
        writer.add_number_sequence('poses', DOUBLE, shapes, len(SAME_POSE))
        for _ in range(EMPTY_SEQUENCES):
            writer.add_count(0)
        writer.add(1, bytes([operation]))
        writer.end_message()
    return writer.finish_series()


def find_axis_poses(start: Array, end: Array) -> tuple[Array, Array]:
    """Return the lengths (..., P) in m of the segments between places (..., P, 3), and their poses (..., P, 7).

    A pose is the position of the middle in m and the quaternion x, y, z, w that turns the z axis to the axis a of
    the segment by the shortest way: (-a_y, a_x, 0, 1 + a_z), of unit length; half a turn about x where the axis
    points down.
    """
    length = np.linalg.norm(end - start, axis=-1)
    axis = (end - start) / np.maximum(length, MIN_LENGTH_M)[..., None]
    axis[length < MIN_LENGTH_M] = 0, 0, 1
    poses = np.zeros((*length.shape, 7))
    poses[..., :3] = (start + end) / 2
    poses[..., 3], poses[..., 4], poses[..., 6] = -axis[..., 1], axis[..., 0], 1 + axis[..., 2]
    norm = np.linalg.norm(poses[..., 3:], axis=-1)
    poses[norm < MIN_QUATERNION, 3:] = 1, 0, 0, 0
    poses[..., 3:] /= np.where(norm < MIN_QUATERNION, 1, norm)[..., None]
    return length, poses


def find_capsule_poses(people: StackedPeople) -> tuple[Array, Array]:
    """Return the lengths (N, P) in m and the poses (N, P, 7) of people's capsules, as of `find_axis_poses`."""
    start, end, _ = people.share(compute_all_capsules)
    return find_axis_poses(start, end)


def _measure_cylinders(people: StackedPeople) -> Array:
    """Return the length and the radius (N, P, 2) in m of the cylinder about each capsule of people."""
    length, _ = people.share(find_capsule_poses)
    radius = people.share(compute_all_capsules).radius
    return np.stack([length + 2 * radius, radius], axis=-1)
