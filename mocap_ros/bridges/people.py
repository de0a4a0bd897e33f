# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""people_msgs/SeenPeople: name, position and velocity of each person, for the social layers of Nav2's costmaps."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.bridges.seen import SeenPeople


def convert_people(people: SeenPeople) -> dict[str, Any]:
    """Return where people are, between their hips, and how they move."""
    numbers = zip(
        people.roots,
        np.nan_to_num(people.root_velocities),
        people.compute_reliability(),
        people.predicted,
        strict=True,
    )
    return {
        'header': people.header,
        'people': [
            {
                'name': person_id,
                'position': root,
                'velocity': velocity,
                'reliability': reliability,
                'tagnames': ['predicted'],
                'tags': [str(bool(is_predicted)).lower()],
            }
            for person_id, (root, velocity, reliability, is_predicted) in zip(people.ids, numbers, strict=True)
        ],
    }
