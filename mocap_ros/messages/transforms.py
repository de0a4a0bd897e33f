"""tf2_msgs/TFMessage: the people as coordinate frames, the fifteen main links of REP-155 under its names.

The parent of `body_<id>` is the camera's optical frame. Its origin lies between the hips. Its axes are

    z = unit(m - o)           up along the trunk, from the hips' midpoint o to the shoulders' midpoint m,
    x = unit((l - r) x z)     forward, where l and r are the left and the right hip,
    y = z x x                 to the left.

All other links are children of `body_<id>` and have its axes: `torso_<id>` between the shoulders, `head_<id>`, and
the joints of the limbs, such as `l_shoulder_<id>`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import Array, Header, create_header, create_message, encode
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
ROOT_LINK = 'body'  # name of the root link in REP-155
MIN_AXIS_LENGTH = 1e-6  # m (up) and m^2 (forward); guards the divisions by them, far under any real size


def encode_transforms(header: Header, people: Sequence[Person3D], prefix: str = '') -> bytes:
    """Encode a TFMessage of all people who are reconstructed in metres.

    Args:
        header: time and frame of the image; its frame_id is the parent of every `body_<id>`.
        people: all people in the image; people who are reconstructed without a focal length are left out.
        prefix: text before the name of every link.
    """
    transforms: list[Any] = []
    used_ids: set[str] = set()
    for person in people:
        axes = compute_body_axes(person.joints)
        if not person.scale_known or axes is None or not header.frame_id:
            continue
        frame_suffix = _make_unique_suffix(person.id, used_ids)
        body = f'{prefix}{ROOT_LINK}_{frame_suffix}'
        positions = compute_link_positions(person.joints)
        root = positions.pop(ROOT_LINK)
        transforms.append(_create_transform(header, body, root, axes))
        body_header = Header(header.stamp_ns, body)
        transforms += [
            _create_transform(body_header, f'{prefix}{link}_{frame_suffix}', (position - root) @ axes)
            for link, position in positions.items()
        ]
    return encode(create_message(TRANSFORMS, transforms=transforms), TRANSFORMS)


def compute_link_positions(joints: Array) -> dict[str, Array]:
    """Compute the origin of each link of REP-155.

    Args:
        joints: (15, 3) m, in the order of `skeleton.CMU15`.

    Returns:
        (3,) position in m by the name of the link.
    """
    position = dict(zip(CMU15.joints, joints, strict=True))
    limbs = {f'{joint[0]}_{joint[1:]}': p for joint, p in position.items() if joint[0] in 'lr'}
    torso, body = ((position[f'l{joint}'] + position[f'r{joint}']) / 2 for joint in ('shoulder', 'hip'))
    return {ROOT_LINK: body, 'torso': torso, 'head': position['head'], **limbs}


def compute_body_axes(joints: Array) -> Array | None:
    """Compute the axes of the link `body`; the head of this module gives the formulas.

    Args:
        joints: (15, 3) m, in the order of `skeleton.CMU15`, in any right-handed frame.

    Returns:
        (3, 3) unit vectors forward, left and up as columns; None where the trunk or the hips have no extent.
    """
    position = compute_link_positions(joints)
    up, left = position['torso'] - position[ROOT_LINK], position['l_hip'] - position['r_hip']
    forward = np.cross(left, up)
    lengths = np.linalg.norm(up), np.linalg.norm(forward)
    if not min(lengths) > MIN_AXIS_LENGTH:
        return None
    up, forward = up / lengths[0], forward / lengths[1]
    return np.stack([forward, np.cross(up, forward), up], axis=-1)


def _make_unique_suffix(person_id: str, used: set[str]) -> str:
    """Return the id in characters that are valid in a frame's name, unlike all in `used`, and add it to `used`."""
    valid = unique = re.sub(r'\W', '_', person_id, flags=re.ASCII)
    number = 1
    while unique in used:
        number += 1
        unique = f'{valid}_{number}'
    used.add(unique)
    return unique


def _create_transform(header: Header, child: str, translation: Array, axes: Array | None = None) -> Any:
    """Create a TransformStamped from the frame of the header to `child`; without `axes` the rotation is none."""
    rotation = (0.0, 0.0, 0.0, 1.0) if axes is None else quaternion_from_rotation(axes)
    return create_message(
        'geometry_msgs/msg/TransformStamped',
        header=create_header(header),
        child_frame_id=child,
        transform=create_message(
            'geometry_msgs/msg/Transform',
            translation=create_message(
                'geometry_msgs/msg/Vector3', **dict(zip('xyz', translation.tolist(), strict=True))
            ),
            rotation=create_message('geometry_msgs/msg/Quaternion', **dict(zip('xyzw', rotation, strict=True))),
        ),
    )
