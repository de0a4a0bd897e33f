"""mocap_ros_msgs/WeakPerspectiveCameraArray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.geometry.rotations import quaternion
from mocap_ros.messages.cdr import OWN, Header, encode, new, new_header
from mocap_ros.people import Person3D

CAMERAS = OWN + 'WeakPerspectiveCameraArray'


def encode_cameras(header: Header, people: Sequence[Person3D]) -> bytes:
    """A WeakPerspectiveCameraArray."""
    message = new(
        CAMERAS,
        header=new_header(header),
        ids=[p.id for p in people],
        cameras=[_new_camera(p) for p in people],
    )
    return encode(message, CAMERAS)


def _new_camera(person: Person3D) -> Any:
    x, y, z, w = quaternion(person.rotation)
    left = person.scale * person.rotation[:2]
    return new(
        OWN + 'WeakPerspectiveCamera',
        scale=person.scale,
        rotation=new('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
        translation=np.asarray(person.translation, np.float64),
        matrix=np.column_stack([left, person.translation]).ravel(),
    )
