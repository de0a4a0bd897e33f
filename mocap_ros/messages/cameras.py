# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/WeakPerspectiveCameraArray: the camera of each person.

A point X of the body frame is imaged at x = s (R X)_xy + t = M [X; 1], where s is the scale, R the rotation,
t the translation and M = [s R_xy | t] the 2x4 camera matrix (Wandt et al., TPAMI 2016, section 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Array, CdrWriter, Header
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.people import Person3D

CAMERAS = MOCAP_ROS_MSGS + 'WeakPerspectiveCameraArray'
CAMERA_NUMBERS = 15  # numbers in a WeakPerspectiveCamera, all of them float64


def encode_cameras(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the cameras of all people in an image as a WeakPerspectiveCameraArray."""
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(len(people))
    for person in people:
        writer.add_text(person.id)
    writer.add_sequence(stack_people(people).share(compute_camera_numbers))
    return writer.finish()


def compute_camera_numbers(people: Sequence[Person3D]) -> Array:
    """Return the fields of the WeakPerspectiveCamera of each person (N, 15) in their order.

    They are the scale, the quaternion x, y, z, w, the translation and the matrix.
    """
    numbers = np.empty((len(people), CAMERA_NUMBERS))
    for row, person in zip(numbers, people, strict=True):
        row[0], row[1:5], row[5:7] = person.scale, quaternion_from_rotation(person.rotation), person.translation
        matrix = row[7:].reshape(2, 4)
        matrix[:, :3], matrix[:, 3] = person.scale * person.rotation[:2], person.translation
    return numbers
