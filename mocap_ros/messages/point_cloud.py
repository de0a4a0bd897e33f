# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/PointCloud2: the joints of all people as points, for viewers that show no markers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cdr import Header
from mocap_ros.messages.plain import encode_plain
from mocap_ros.people import Person3D

POINTS = 'sensor_msgs/msg/PointCloud2'
DATATYPES = {'<f4': 7, '<u2': 4, '|u1': 2}  # sensor_msgs/PointField.datatype by NumPy's name of the type
POINT_DTYPE = np.dtype(
    {
        'names': ['x', 'y', 'z', 'std', 'person', 'joint', 'inferred'],
        'formats': ['<f4', '<f4', '<f4', '<f4', '<u2', 'u1', 'u1'],
    }
)
_FIELDS = [(name, (dtype, offset)) for name, (dtype, offset, *_) in (POINT_DTYPE.fields or {}).items()]


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
    message = {
        'header': header,
        'height': 1,
        'width': cloud.size,
        'fields': [(name, offset, DATATYPES[dtype.str], 1) for name, (dtype, offset) in _FIELDS],
        'point_step': POINT_DTYPE.itemsize,
        'row_step': POINT_DTYPE.itemsize * cloud.size,
        'data': np.frombuffer(cloud.tobytes(), np.uint8),
        'is_dense': True,
    }
    return encode_plain(message, POINTS)
