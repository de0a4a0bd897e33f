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
import struct
from collections.abc import Sequence

import numpy as np

from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import Array, CdrWriter, Header, encode_header
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
ROOT_LINK = 'body'  # name of the root link in REP-155
MIN_AXIS_LENGTH = 1e-6  # m (up) and m^2 (forward); guards the divisions by them, far under any real size

# Joints of which some links are made, by name or by index.
_LIMB_JOINTS = tuple(joint for joint in CMU15.joints if joint[0] in 'lr')
_LIMB_INDICES = np.array([CMU15.index(joint) for joint in _LIMB_JOINTS])
_SHOULDERS, _HIPS = (np.array([CMU15.index(side + joint) for side in 'lr']) for joint in ('shoulder', 'hip'))
# The other links of REP-155 in the order in which they are sent.
CHILD_LINKS = ('torso', 'head', *(f'{joint[0]}_{joint[1:]}' for joint in _LIMB_JOINTS))
_TRANSFORM = struct.Struct('<7d')  # translation, and the quaternion x, y, z, w


def encode_transforms(header: Header, people: Sequence[Person3D], prefix: str = '') -> bytes:
    """Encode a TFMessage of all people who are reconstructed in metres.

    Args:
        header: time and frame of the image; its frame_id is the parent of every `body_<id>`.
        people: all people in the image; people who are reconstructed without a focal length are left out.
        prefix: text before the name of every link.
    """
    shown = [p for p in people if p.scale_known and header.frame_id]
    joints = np.array([p.joints for p in shown]).reshape(-1, len(CMU15.joints), 3)
    roots, children, axes = compute_links(joints)
    has_axes = np.isfinite(axes).all(axis=(1, 2))
    children = (children - roots[:, None]) @ axes
    writer = CdrWriter()
    writer.add_count(int(has_axes.sum()) * (1 + len(CHILD_LINKS)))
    camera_header, used_ids = encode_header(header), set[str]()
    for index in np.flatnonzero(has_axes):
        suffix = _make_unique_suffix(shown[index].id, used_ids)
        body = f'{prefix}{ROOT_LINK}_{suffix}'
        _add_transform(writer, camera_header, body, roots[index].tolist(), quaternion_from_rotation(axes[index]))
        body_header = encode_header(Header(header.stamp_ns, body))
        for link, position in zip(CHILD_LINKS, children[index].tolist(), strict=True):
            _add_transform(writer, body_header, f'{prefix}{link}_{suffix}', position, NO_ROTATION)
    return writer.finish()


def compute_links(joints: Array) -> tuple[Array, Array, Array]:
    """Compute the links of REP-155 of several people; the head of this module gives the formulas.

    Args:
        joints: (N, 15, 3) m, in the order of `skeleton.CMU15`, in any right-handed frame.

    Returns:
        Origins (N, 3) of `body` in m, origins (N, 14, 3) of `CHILD_LINKS` in m, and the axes (N, 3, 3) of all of
        them as unit vectors forward, left and up in columns. The axes of a person whose trunk or hips have no
        extent are NaN.
    """
    torso, body = (joints[:, pair].mean(axis=1) for pair in (_SHOULDERS, _HIPS))
    head = joints[:, CMU15.index('head')]
    up, left = torso - body, joints[:, _HIPS[0]] - joints[:, _HIPS[1]]
    forward = np.cross(left, up)
    lengths = np.stack([np.linalg.norm(up, axis=1), np.linalg.norm(forward, axis=1)], axis=1)
    lengths[~(lengths.min(axis=1) > MIN_AXIS_LENGTH)] = np.nan
    up, forward = up / lengths[:, :1], forward / lengths[:, 1:]
    axes = np.stack([forward, np.cross(up, forward), up], axis=-1)
    return body, np.concatenate([torso[:, None], head[:, None], joints[:, _LIMB_INDICES]], axis=1), axes


def _make_unique_suffix(person_id: str, used: set[str]) -> str:
    """Return the id in characters that are valid in a frame's name, unlike all in `used`, and add it to `used`."""
    valid = unique = re.sub(r'\W', '_', person_id, flags=re.ASCII)
    number = 1
    while unique in used:
        number += 1
        unique = f'{valid}_{number}'
    used.add(unique)
    return unique


def _add_transform(
    writer: CdrWriter, header: bytes, child: str, translation: Sequence[float], rotation: Sequence[float]
) -> None:
    """Append the TransformStamped from the frame of the header to `child`."""
    writer.add(4, header)
    writer.add_text(child)
    writer.add(8, _TRANSFORM.pack(*translation, *rotation))
