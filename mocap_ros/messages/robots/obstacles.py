# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""nav2_dynamic_msgs/ObstacleArray: people as moving obstacles, for Nav2's trackers and dynamic layers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from mocap_ros.messages.cdr import Header
from mocap_ros.messages.robots.shared import compute_boxes, compute_reliability
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, SINGLE, MessageTemplate, TemplateWriter
from mocap_ros.people import Person3D

POSITION_VELOCITY_SIZE = 3 + 3 + 3  # numbers of an obstacle


def encode_obstacles(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode people as obstacles; the arguments are those of `people.encode_people`.

    The position is the middle of the box around the person. The UUID follows from the person's id alone.
    """
    stacked = stack_people(people)
    boxes = stacked.share(compute_boxes)
    return _lay_out(header.frame_id, stacked.ids).fill(
        header.stamp_ns,
        score=[compute_reliability(p) for p in stacked],
        numbers=np.column_stack([boxes.centre, stacked.known_velocities, boxes.size]),
    )


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, ids: tuple[str, ...]) -> MessageTemplate:
    """Return the template for people with some ids."""
    writer = TemplateWriter()
    writer.add_stamped(frame_id)
    writer.add_count(len(ids))
    for person_id in ids:
        writer.add(1, uuid5(NAMESPACE_URL, f'mocap_ros:{person_id}').bytes)
        writer.add_numbers('score', SINGLE, 1)
        writer.add_numbers('numbers', DOUBLE, POSITION_VELOCITY_SIZE)
    return writer.finish_template()
