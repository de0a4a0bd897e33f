"""People as coordinate frames, named as REP-155 names them.

`body_<id>` lies at the pelvis, x forward, y to the left, z up along the spine; its parent is the camera's optical
frame. Its children are the joints, `l_shoulder_<id>` and so on, which are turned as it is.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mocap_ros.io.messages import Array, Header, encode, new, new_header
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
SHORTEST = 1e-6


def encode_transforms(header: Header, people: Sequence[Person3D], prefix: str = '') -> bytes:
    """A TFMessage of those whose place is known in metres.

    Args:
        header: of the frame; its frame_id is the parent.
        people: everyone in it; those reconstructed without a focal length are left out.
        prefix: before every frame's name.
    """
    transforms: list[Any] = []
    taken: set[str] = set()
    for person in people:
        axes = body_axes(person.joints)
        if not person.scale_known or axes is None or not header.frame_id:
            continue
        name = _safe(person.id, taken)
        body = f'{prefix}body_{name}'
        pelvis = person.joints[CMU15.index('pelvis')]
        transforms.append(_transform(header, body, pelvis, axes))
        inside = (person.joints - pelvis) @ axes
        below = Header(header.stamp_ns, body)
        transforms += [
            _transform(below, f'{prefix}{rep155_name(joint)}_{name}', place)
            for joint, place in zip(CMU15.joints, inside, strict=True)
            if joint != 'pelvis'
        ]
    return encode(new(TRANSFORMS, transforms=transforms), TRANSFORMS)


def body_axes(joints: Array) -> Array | None:
    """(3, 3) with the directions forward, left and up of a body as columns; None where its bones have no length.

    Args:
        joints: (15, 3) m, in the order of `skeleton.CMU15`, in any right-handed frame.
    """
    at = {name: joints[CMU15.index(name)] for name in ('lhip', 'rhip', 'neck', 'pelvis')}
    up, left = at['neck'] - at['pelvis'], at['lhip'] - at['rhip']
    forward = np.cross(left, up)
    lengths = np.linalg.norm(up), np.linalg.norm(forward)
    if not min(lengths) > SHORTEST:
        return None
    up, forward = up / lengths[0], forward / lengths[1]
    return np.stack([forward, np.cross(up, forward), up], axis=-1)


def rep155_name(joint: str) -> str:
    """`l_shoulder` for `lshoulder`."""
    return f'{joint[0]}_{joint[1:]}' if joint[0] in 'lr' else joint


def _safe(name: str, taken: set[str]) -> str:
    """The id with nothing in it that a frame's name cannot hold, unlike those before."""
    plain = safe = re.sub(r'\W', '_', name, flags=re.ASCII)
    number = 1
    while safe in taken:
        number += 1
        safe = f'{plain}_{number}'
    taken.add(safe)
    return safe


def _transform(header: Header, child: str, place: Array, axes: Array | None = None) -> Any:
    turn = [0.0, 0.0, 0.0, 1.0] if axes is None else Rotation.from_matrix(axes).as_quat().tolist()
    return new(
        'geometry_msgs/msg/TransformStamped',
        header=new_header(header),
        child_frame_id=child,
        transform=new(
            'geometry_msgs/msg/Transform',
            translation=new('geometry_msgs/msg/Vector3', **dict(zip('xyz', place.tolist(), strict=True))),
            rotation=new('geometry_msgs/msg/Quaternion', **dict(zip('xyzw', turn, strict=True))),
        ),
    )
