"""mocap_ros_msgs/WeakPerspectiveCameraArray: the camera of each person.

A point X of the body frame is imaged at x = s (R X)_xy + t = M [X; 1], where s is the scale, R the rotation,
t the translation and M = [s R_xy | t] the 2x4 camera matrix (Wandt et al., TPAMI 2016, section 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, create_header, create_message, encode
from mocap_ros.people import Person3D

CAMERAS = MOCAP_ROS_MSGS + 'WeakPerspectiveCameraArray'


def encode_cameras(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the cameras of all people in an image as a WeakPerspectiveCameraArray."""
    message = create_message(
        CAMERAS,
        header=create_header(header),
        ids=[p.id for p in people],
        cameras=[create_camera(p) for p in people],
    )
    return encode(message, CAMERAS)


def create_camera(person: Person3D) -> Any:
    """Create the WeakPerspectiveCamera object of one person."""
    x, y, z, w = quaternion_from_rotation(person.rotation)
    scaled_rotation = person.scale * person.rotation[:2]
    return create_message(
        MOCAP_ROS_MSGS + 'WeakPerspectiveCamera',
        scale=person.scale,
        rotation=create_message('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
        translation=np.asarray(person.translation, np.float64),
        matrix=np.column_stack([scaled_rotation, person.translation]).ravel(),
    )
