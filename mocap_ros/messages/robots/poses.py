"""geometry_msgs/PoseArray: where people are and where they face, for everything that shows or takes poses."""

from __future__ import annotations

from collections.abc import Sequence

from mocap_ros.messages.cdr import Header, create_header, create_message, encode
from mocap_ros.messages.robots.shared import compute_orientations, create_pose
from mocap_ros.people import Person3D

POSES = 'geometry_msgs/msg/PoseArray'


def encode_poses(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the pose of each body, between the hips; the arguments are those of `people.encode_people`."""
    poses = [create_pose(p.root, q) for p, q in zip(people, compute_orientations(people), strict=True)]
    return encode(create_message(POSES, header=create_header(header), poses=poses), POSES)
