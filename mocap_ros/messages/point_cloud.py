"""The joints as a point cloud: for viewers that draw no markers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cdr import Header, encode, new, new_header
from mocap_ros.people import Person3D

POINTS = 'sensor_msgs/msg/PointCloud2'


UINT8, UINT16, FLOAT32 = 2, 4, 7


POINT = np.dtype(
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


DATATYPES = {'f4': FLOAT32, 'u2': UINT16, 'u1': UINT8}


def encode_points(header: Header, people: Sequence[Person3D]) -> bytes:
    """A PointCloud2 of everyone's joints, one row.

    Fields: x, y, z and std (m), person (place in the Skeleton3DArray), joint (place in the SkeletonDefinition) and
    inferred (1 where the joint was not seen).
    """
    cloud = np.zeros((len(people), len(people[0].joints) if people else 0), POINT)
    for index, person in enumerate(people):
        row = cloud[index]
        row['x'], row['y'], row['z'] = person.joints.T
        row['std'], row['inferred'] = person.std, person.inferred
        row['person'], row['joint'] = index, np.arange(len(person.joints))
    fields = [
        new(
            'sensor_msgs/msg/PointField',
            name=name,
            offset=POINT.fields[name][1],  # type: ignore[index]
            datatype=DATATYPES[POINT[name].str[1:]],
            count=1,
        )
        for name in POINT.names or ()
    ]
    message = new(
        POINTS,
        header=new_header(header),
        height=1,
        width=cloud.size,
        fields=fields,
        is_bigendian=False,
        point_step=POINT.itemsize,
        row_step=POINT.itemsize * cloud.size,
        data=np.frombuffer(cloud.tobytes(), np.uint8),
        is_dense=True,
    )
    return encode(message, POINTS)
