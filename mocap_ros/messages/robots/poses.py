# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""geometry_msgs/PoseArray: where people are and where they face, for everything that shows or takes poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cdr import CdrWriter, Header
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.messages.transforms import compute_orientations
from mocap_ros.people import Person3D

POSES = 'geometry_msgs/msg/PoseArray'


def encode_poses(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the pose of each body, between the hips; the arguments are those of `people.encode_people`."""
    stacked, writer = stack_people(people), CdrWriter()
    writer.add_header(header)
    writer.add_sequence(np.column_stack([stacked.roots, stacked.share(compute_orientations)]))
    return writer.finish()
