"""Messages of /tf and /tf_static."""

from __future__ import annotations

from typing import Any

from mocap_ros.messages.cdr import Header, create_header, create_message, encode
from mocap_ros.messages.transforms import TRANSFORMS

SECOND_NS = 1_000_000_000  # ns in a second


def make_transforms(*transforms: Any) -> bytes:
    """Return a TFMessage of (parent, child, stamp in ns, translation in m, and optionally a quaternion)."""
    return encode(create_message(TRANSFORMS, transforms=[_create(*t) for t in transforms]), TRANSFORMS)


def _create(parent: str, child: str, stamp_ns: int, translation: Any, rotation: Any = (0, 0, 0, 1)) -> Any:
    x, y, z, w = map(float, rotation)
    place = dict(zip('xyz', map(float, translation), strict=True))
    return create_message(
        'geometry_msgs/msg/TransformStamped',
        header=create_header(Header(stamp_ns, parent)),
        child_frame_id=child,
        transform=create_message(
            'geometry_msgs/msg/Transform',
            translation=create_message('geometry_msgs/msg/Vector3', **place),
            rotation=create_message('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
        ),
    )
