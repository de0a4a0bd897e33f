"""nav2_dynamic_msgs/ObstacleArray: people as moving obstacles, for Nav2's trackers and dynamic layers."""

from __future__ import annotations

from collections.abc import Sequence
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from mocap_ros.messages.cdr import Header, create_header, create_message, encode
from mocap_ros.messages.foreign.definitions import OBSTACLES
from mocap_ros.messages.robots.shared import (
    compute_extent,
    compute_reliability,
    create_point,
    create_vector,
    known_velocity,
)
from mocap_ros.people import Person3D


def encode_obstacles(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode people as obstacles; the arguments are those of `people.encode_people`.

    The position is the middle of the box around the person. The UUID follows from the person's id alone.
    """
    obstacles = []
    for person in people:
        extent = compute_extent(person)
        number = np.frombuffer(uuid5(NAMESPACE_URL, f'mocap_ros:{person.id}').bytes, np.uint8)
        obstacles.append(
            create_message(
                'nav2_dynamic_msgs/msg/Obstacle',
                uuid=create_message('unique_identifier_msgs/msg/UUID', uuid=number),
                score=compute_reliability(person),
                position=create_point(extent.centre),
                velocity=create_vector(known_velocity(person)),
                size=create_vector(extent.size),
            )
        )
    return encode(create_message(OBSTACLES, header=create_header(header), obstacles=obstacles), OBSTACLES)
