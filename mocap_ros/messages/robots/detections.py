# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""vision_msgs/Detection3DArray: pose with covariance, and the box around each person."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.messages.cdr import Array, Header
from mocap_ros.messages.robots.shared import compute_boxes, compute_heading_stds, compute_reliability
from mocap_ros.messages.stacked_people import StackedPeople, stack_people
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, MessageTemplate, TemplateWriter
from mocap_ros.messages.transforms import compute_orientations
from mocap_ros.people import Person3D

CLASS_ID = 'person'  # ObjectHypothesis.class_id
SCORE_POSE_COVARIANCE_BOX = 1 + 7 + 36 + 7 + 3  # numbers of a detection


def encode_detections(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode people as detections; the arguments are those of `people.encode_people`.

    The pose is that of the place between the hips, with the axes of the body (x forward, z up along the trunk).
    The covariance is of x, y, z and of the rotations about x, y, z.
    """
    stacked = stack_people(people)
    boxes = stacked.share(compute_boxes)
    numbers = np.column_stack(
        [
            [compute_reliability(p) for p in stacked],
            stacked.roots,
            stacked.share(compute_orientations),
            _build_covariances(stacked).reshape(-1, 36),
            boxes.centre,
            np.tile(NO_ROTATION, (len(stacked), 1)),
            boxes.size,
        ]
    )
    return _lay_out(header.frame_id, stacked.ids).fill(header.stamp_ns, numbers=numbers)


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, ids: tuple[str, ...]) -> MessageTemplate:
    """Return the template for people with some ids."""
    writer = TemplateWriter()
    writer.add_stamped(frame_id)
    writer.add_count(len(ids))
    for person_id in ids:
        writer.add_stamped(frame_id)
        writer.add_count(1)  # results
        writer.add_text(CLASS_ID)
        writer.add_numbers('numbers', DOUBLE, SCORE_POSE_COVARIANCE_BOX)
        writer.add_text(person_id)
    return writer.finish_template()


def _build_covariances(people: StackedPeople) -> Array:
    """Return the covariances (N, 6, 6) of people's poses, in m and rad."""
    covariance = np.zeros((len(people), 6, 6))
    covariance[:, :3, :3] = np.array([p.root_covariance for p in people]).reshape(-1, 3, 3)
    covariance[:, 3:, 3:] = (compute_heading_stds(people) ** 2)[:, None, None] * np.eye(3)
    return covariance
