# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""geometry_msgs/PoseArray: where people are and where they face, for everything that shows or takes poses."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_ros.bridges.seen import SeenPeople


def convert_poses(people: SeenPeople) -> dict[str, Any]:
    """Return the pose of each body, between the hips."""
    poses = np.column_stack([people.roots, people.compute_orientations()])
    return {'header': people.header, 'poses': poses}
