# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/PointCloud2: the joints of all people as points, for viewers that show no markers."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cdr import CdrWriter, Header
from mocap_ros.people import Person3D

POINTS = 'sensor_msgs/msg/PointCloud2'

# Values of sensor_msgs/PointField.datatype.
UINT8 = 2
UINT16 = 4
FLOAT32 = 7

DATATYPES = {'f4': FLOAT32, 'u2': UINT16, 'u1': UINT8}  # PointField.datatype by NumPy's name of the type

# The fields of a point; their meaning is documented at `encode_points`.
POINT_DTYPE = np.dtype(
    [
        ('x', '<f4'),
        ('y', '<f4'),
        ('z', '<f4'),
        ('std', '<f4'),
        ('person', '<u2'),
        ('joint', 'u1'),
        ('inferred', 'u1'),
    ]
)

_SIZE = struct.Struct('<II')  # height, width
_FIELD = struct.Struct('<IB')  # offset and datatype of a PointField
_STEPS = struct.Struct('<II')  # point_step, row_step


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
    joints = len(people[0].joints) if people else 0
    cloud = np.zeros((len(people), joints), POINT_DTYPE)
    cloud['person'], cloud['joint'] = np.arange(len(people))[:, None], np.arange(joints)
    for row, person in zip(cloud, people, strict=True):
        row['x'], row['y'], row['z'] = person.joints.T
        row['std'], row['inferred'] = person.std, person.inferred
    writer = CdrWriter()
    writer.add_header(header)
    writer.add(4, _SIZE.pack(1, cloud.size))
    writer.add_count(len(POINT_DTYPE.names or ()))
    for name, (dtype, offset, *_) in (POINT_DTYPE.fields or {}).items():
        writer.add_text(name)
        writer.add(4, _FIELD.pack(offset, DATATYPES[dtype.str[1:]]))
        writer.add_count(1)
    writer.add(1, b'\0')  # is_bigendian
    writer.add(4, _STEPS.pack(POINT_DTYPE.itemsize, POINT_DTYPE.itemsize * cloud.size))
    writer.add_sequence(np.frombuffer(cloud.tobytes(), np.uint8))
    writer.add(1, b'\1')  # is_dense
    return writer.finish()
