# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/PointCloud2: the joints of all people as points, for viewers that show no markers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cdr import BYTE, CdrWriter, Header
from mocap_ros.people import Person3D

POINTS = 'sensor_msgs/msg/PointCloud2'
DATATYPES = {'<f4': 7, '<u2': 4, '|u1': 2}  # sensor_msgs/PointField.datatype by NumPy's name of the type
POINT_FIELDS = {
    'x': '<f4', 'y': '<f4', 'z': '<f4', 'std': '<f4', 'person': '<u2', 'joint': '|u1', 'inferred': '|u1',
}  # fmt: skip
POINT_DTYPE = np.dtype(list(POINT_FIELDS.items()))


def encode_points(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the joints of all people as an unordered PointCloud2 (height 1).

    The fields of a point are
    - `x`, `y`, `z`: position in m,
    - `std`: standard deviation of the position in m,
    - `person`: index of the person in the Skeleton3DArray,
    - `joint`: index of the joint in the SkeletonDefinition,
    - `inferred`: 1 where the joint was not seen and the model inferred it, else 0.

    Args:
        header: time and frame of the image.
        people: all people in the image.
    """
    cloud = np.zeros((len(people), len(people[0].joints) if people else 0), POINT_DTYPE)
    for index, (row, person) in enumerate(zip(cloud, people, strict=True)):
        row['x'], row['y'], row['z'] = person.joints.T
        row['std'], row['inferred'] = person.std, person.inferred
        row['person'], row['joint'] = index, np.arange(len(row))
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(1)  # height
    writer.add_count(cloud.size)  # width
    writer.add_count(len(POINT_FIELDS))
    offset = 0
    for name, dtype in POINT_FIELDS.items():
        writer.add_text(name)
        writer.add_count(offset)
        writer.add_numbers(DATATYPES[dtype], BYTE)
        writer.add_count(1)  # numbers in the field
        offset += np.dtype(dtype).itemsize
    writer.add_numbers(False, BYTE)  # is_bigendian
    writer.add_count(offset)  # bytes of a point
    writer.add_count(offset * cloud.size)  # bytes of a row
    writer.add_sequence(np.frombuffer(cloud.tobytes(), BYTE), BYTE)
    writer.add_numbers(True, BYTE)  # is_dense
    return writer.finish()
