"""What the messages for robots share: reliability, extent and direction of a person, and parts of messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import Array, create_message
from mocap_ros.messages.transforms import compute_links
from mocap_ros.people import HIPS, Person3D

RELIABILITY_FADE_S = 1.0  # s; the reliability of a person who has not been seen for so long is a third
FLESH_M = 0.1  # m; how far a body reaches beyond its joints: half a trunk's depth, a hand beyond its wrist


class Extent(NamedTuple):
    """The box around a person, along the axes of the frame.

    Attributes:
        centre: (3,) m.
        size: (3,) m.
    """

    centre: Array
    size: Array


def compute_reliability(person: Person3D) -> float:
    """Return how sure it is that a person is there: 1 for one who is seen, less the longer one is not."""
    return math.exp(-person.unseen_for / RELIABILITY_FADE_S)


def compute_extent(person: Person3D) -> Extent:
    """Return the box around the joints of a person and the flesh about them."""
    low, high = person.joints.min(axis=0) - FLESH_M, person.joints.max(axis=0) + FLESH_M
    return Extent((low + high) / 2, high - low)


def compute_orientations(people: Sequence[Person3D]) -> list[tuple[float, float, float, float]]:
    """Return the quaternion x, y, z, w of each body: x forward, y left, z up along the trunk.

    It is that of the links on /tf; that of a body whose axes are not known is no rotation.
    """
    if not people:
        return []
    _, _, axes = compute_links(np.array([p.joints for p in people]))
    return [quaternion_from_rotation(a) if np.isfinite(a).all() else NO_ROTATION for a in axes]


def compute_heading_std(person: Person3D) -> float:
    """Return the standard deviation in rad of a body's direction: hips that are off turn the line between them.

    With the standard deviation std / sqrt(3) of each coordinate, the line of length b turns by sqrt(2/3) std / b.
    It is that of a direction of which nothing is known where nothing is known of the joints.
    """
    left, right = HIPS
    breadth = float(np.linalg.norm(person.joints[left] - person.joints[right]))
    std = math.sqrt(2 / 3) * float(person.std[left] + person.std[right]) / 2 / max(breadth, FLESH_M)
    unknown = math.pi / math.sqrt(3)
    return min(std, unknown) if math.isfinite(std) else unknown


def create_point(values: Array) -> Any:
    """Create a geometry_msgs/Point of (3,) m."""
    x, y, z = values.tolist()
    return create_message('geometry_msgs/msg/Point', x=x, y=y, z=z)


def create_vector(values: Array) -> Any:
    """Create a geometry_msgs/Vector3 of (3,) numbers."""
    x, y, z = values.tolist()
    return create_message('geometry_msgs/msg/Vector3', x=x, y=y, z=z)


def create_pose(position: Array, quaternion: Sequence[float]) -> Any:
    """Create a geometry_msgs/Pose of (3,) m and a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return create_message(
        'geometry_msgs/msg/Pose',
        position=create_point(position),
        orientation=create_message('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
    )


def known_velocity(person: Person3D) -> Array:
    """Return the velocity of the root (3,) m/s; 0 where it is unknown, as consumers take no NaN."""
    return np.nan_to_num(person.root_velocity)
