"""vision_msgs/Detection3DArray: pose with covariance, and the box around each person."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.messages.cdr import Array, Header, create_header, create_message, encode
from mocap_ros.messages.foreign.definitions import DETECTIONS_3D
from mocap_ros.messages.robots.shared import (
    compute_extent,
    compute_heading_std,
    compute_orientations,
    compute_reliability,
    create_pose,
    create_vector,
)
from mocap_ros.people import Person3D

CLASS_ID = 'person'  # ObjectHypothesis.class_id


def encode_detections(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode people as detections; the arguments are those of `people.encode_people`.

    The pose is that of the place between the hips, with the axes of the body (x forward, z up along the trunk).
    The covariance is of x, y, z and of the rotations about x, y, z.
    """
    stamped, detections = create_header(header), []
    for person, orientation in zip(people, compute_orientations(people), strict=True):
        extent = compute_extent(person)
        pose = create_message(
            'geometry_msgs/msg/PoseWithCovariance',
            pose=create_pose(person.root, orientation),
            covariance=_build_covariance(person).ravel(),
        )
        hypothesis = create_message(
            'vision_msgs/msg/ObjectHypothesis', class_id=CLASS_ID, score=compute_reliability(person)
        )
        detections.append(
            create_message(
                'vision_msgs/msg/Detection3D',
                header=stamped,
                results=[
                    create_message('vision_msgs/msg/ObjectHypothesisWithPose', hypothesis=hypothesis, pose=pose)
                ],
                bbox=create_message(
                    'vision_msgs/msg/BoundingBox3D',
                    center=create_pose(extent.centre, NO_ROTATION),
                    size=create_vector(extent.size),
                ),
                id=person.id,
            )
        )
    return encode(create_message(DETECTIONS_3D, header=stamped, detections=detections), DETECTIONS_3D)


def _build_covariance(person: Person3D) -> Array:
    """Return the covariance (6, 6) of a person's pose, in m and rad."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = person.root_covariance
    covariance[3:, 3:] = compute_heading_std(person) ** 2 * np.eye(3)
    return covariance
