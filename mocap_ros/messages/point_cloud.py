"""sensor_msgs/PointCloud2: the joints of all people as points, for viewers that show no markers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.messages.cdr import Header, create_header, create_message, encode
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
    for index, person in enumerate(people):
        row = cloud[index]
        row['x'], row['y'], row['z'] = person.joints.T
        row['std'], row['inferred'] = person.std, person.inferred
        row['person'], row['joint'] = index, np.arange(len(person.joints))
    fields = [
        create_message(
            'sensor_msgs/msg/PointField',
            name=name,
            offset=POINT_DTYPE.fields[name][1],  # type: ignore[index]
            datatype=DATATYPES[POINT_DTYPE[name].str[1:]],
            count=1,
        )
        for name in POINT_DTYPE.names or ()
    ]
    message = create_message(
        POINTS,
        header=create_header(header),
        height=1,
        width=cloud.size,
        fields=fields,
        is_bigendian=False,
        point_step=POINT_DTYPE.itemsize,
        row_step=POINT_DTYPE.itemsize * cloud.size,
        data=np.frombuffer(cloud.tobytes(), np.uint8),
        is_dense=True,
    )
    return encode(message, POINTS)
