"""People as coordinate frames: the fifteen main links of REP-155, by its names.

`body_<id>` lies between the hips, x forward, y to the left, z up along the trunk; its parent is the camera's
optical frame. Its children are the others, which are turned as it is: `torso_<id>` between the shoulders,
`head_<id>`, and the joints of the limbs, `l_shoulder_<id>` and so on.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.geometry.rotations import quaternion
from mocap_ros.messages.cdr import Header, encode, new, new_header
from mocap_ros.messages.keypoints import Array
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
ROOT = 'body'
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
        body = f'{prefix}{ROOT}_{name}'
        places = links(person.joints)
        root = places.pop(ROOT)
        transforms.append(_transform(header, body, root, axes))
        below = Header(header.stamp_ns, body)
        transforms += [
            _transform(below, f'{prefix}{link}_{name}', (place - root) @ axes) for link, place in places.items()
        ]
    return encode(new(TRANSFORMS, transforms=transforms), TRANSFORMS)


def links(joints: Array) -> dict[str, Array]:
    """(3,) m, where each link of REP-155 lies, by its name.

    Args:
        joints: (15, 3) m, in the order of `skeleton.CMU15`.
    """
    at = dict(zip(CMU15.joints, joints, strict=True))
    limbs = {f'{joint[0]}_{joint[1:]}': place for joint, place in at.items() if joint[0] in 'lr'}
    torso, body = ((at[f'l{joint}'] + at[f'r{joint}']) / 2 for joint in ('shoulder', 'hip'))
    return {ROOT: body, 'torso': torso, 'head': at['head'], **limbs}


def body_axes(joints: Array) -> Array | None:
    """(3, 3) with the directions forward, left and up of a body as columns; None where its bones have no length.

    Args:
        joints: (15, 3) m, in the order of `skeleton.CMU15`, in any right-handed frame.
    """
    at = links(joints)
    up, left = at['torso'] - at[ROOT], at['l_hip'] - at['r_hip']
    forward = np.cross(left, up)
    lengths = np.linalg.norm(up), np.linalg.norm(forward)
    if not min(lengths) > SHORTEST:
        return None
    up, forward = up / lengths[0], forward / lengths[1]
    return np.stack([forward, np.cross(up, forward), up], axis=-1)


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
    turn = (0.0, 0.0, 0.0, 1.0) if axes is None else quaternion(axes)
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
