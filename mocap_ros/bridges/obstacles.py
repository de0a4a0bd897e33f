# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""nav2_dynamic_msgs/ObstacleArray: people as moving obstacles, for Nav2's trackers and dynamic layers."""

from __future__ import annotations

from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from mocap_ros.bridges.seen import SeenPeople


def convert_obstacles(people: SeenPeople) -> dict[str, Any]:
    """Return people as obstacles.

    The position is the middle of the box around the person. The UUID follows from the person's id alone.
    """
    centres, sizes = people.compute_boxes()
    numbers = zip(people.compute_reliability(), centres, np.nan_to_num(people.root_velocities), sizes, strict=True)
    return {
        'header': people.header,
        'obstacles': [
            {
                'uuid': list(uuid5(NAMESPACE_URL, f'mocap_ros:{person_id}').bytes),
                'score': score,
                'position': centre,
                'velocity': velocity,
                'size': size,
            }
            for person_id, (score, centre, velocity, size) in zip(people.ids, numbers, strict=True)
        ],
    }
