"""tf2_msgs/TFMessage: the people as coordinate frames, the main links of REP-155 under its names.

The parent of `body_<id>` is the camera's optical frame. Its origin lies between the hips. Its axes are

    z = unit(m - o)           up along the trunk, from the hips' midpoint o to the shoulders' midpoint m,
    x = unit((l - r) x z)     forward, where l and r are the left and the right hip,
    y = z x x                 to the left.

All other links are children of `body_<id>`: `torso_<id>` between the shoulders, `head_<id>`, the joints of the
limbs, such as `l_shoulder_<id>`, and toes, heels, hands, eyes, ears and nose where people have them. Each is
turned as the segment of the body that turns about it or holds it (`solvers.body_segments`): `l_shoulder_<id>` is
the left upper arm. Of somebody who stands upright with hanging arms, all have the axes of the body.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.messages.cdr import Array, CdrWriter, Header, encode_header
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, Skeleton

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
ROOT_LINK = 'body'  # name of the root link in REP-155
TORSO_LINK = 'torso'  # name of the link between the shoulders
MIDDLE_LINKS = 'head', 'nose'  # joints of the middle of the body that are links
MIN_AXIS_LENGTH = 1e-6  # m (up) and m^2 (forward); guards the divisions by them, far under any real size

_SHOULDERS, _HIPS = (np.array([CMU15.index(side + joint) for side in 'lr']) for joint in ('shoulder', 'hip'))


class _Links(NamedTuple):
    """The links of a skeleton besides `body`, in the order in which they are sent.

    Attributes:
        names: names of the links.
        joints: (L - 1,) index of the joint at which each of them is, but the first: it is the torso.
    """

    names: tuple[str, ...]
    joints: NDArray[np.intp]


@lru_cache(maxsize=2)  # skeletons
def _list_links(skeleton: Skeleton) -> _Links:
    """Return the links of a skeleton."""
    pairs = skeleton.left_right_pairs
    sided = sorted(joint for pair in pairs for joint in pair)
    middle = [skeleton.joints.index(n) for n in MIDDLE_LINKS if n in skeleton.joints]
    names = [skeleton.joints[j] for j in middle] + [f'{n[0]}_{n[1:]}' for n in (skeleton.joints[j] for j in sided)]
    return _Links((TORSO_LINK, *names), np.array([*middle, *sided]))


_TORSO_SEGMENT = CMU15.index('neck')  # joint about which the torso turns (`solvers.body_segments`)
_TRANSFORM = struct.Struct('<7d')  # translation, and the quaternion x, y, z, w


CHILD_LINKS = _list_links(BODY26).names  # all links besides `body` that any skeleton has


def encode_transforms(header: Header, people: Sequence[Person3D], prefix: str = '') -> bytes:
    """Encode a TFMessage of all people who are reconstructed in metres.

    Args:
        header: time and frame of the image; its frame_id is the parent of every `body_<id>`.
        people: all people in the image; people who are reconstructed without a focal length are left out.
        prefix: text before the name of every link.
    """
    placed = _place_bodies([p for p in people if p.scale_known and header.frame_id])
    writer = CdrWriter()
    writer.add_count(sum(1 + len(_list_links(person.skeleton).names) for person, _ in placed))
    camera_header, used_ids = encode_header(header), set[str]()
    for person, (root, torso, axes) in placed:
        suffix = _make_unique_suffix(person.id, used_ids)
        name, rotation = f'{prefix}{ROOT_LINK}_{suffix}', quaternion_from_rotation(axes)
        _add_transform(writer, camera_header, name, root.tolist(), rotation)
        body_header = encode_header(Header(header.stamp_ns, name))
        links = _list_links(person.skeleton)
        positions = (np.concatenate([torso[None], person.joints[links.joints]]) - root) @ axes
        to_body = np.array([*np.negative(rotation[:3]), rotation[3]])
        turned = multiply_quaternions(to_body, person.orientation[[_TORSO_SEGMENT, *links.joints]])
        turned[~np.isfinite(turned).all(axis=1)] = NO_ROTATION
        for link, position, turn in zip(links.names, positions.tolist(), turned.tolist(), strict=True):
            _add_transform(writer, body_header, f'{prefix}{link}_{suffix}', position, turn)
    return writer.finish()


def _place_bodies(people: Sequence[Person3D]) -> list[tuple[Person3D, tuple[Array, Array, Array]]]:
    """Return people who have axes, with root (3,) m, torso (3,) m and axes (3, 3), as of `compute_links`."""
    if not people:
        return []
    found = zip(*compute_links(np.array([p.joints for p in people])), strict=True)
    return [(person, body) for person, body in zip(people, found, strict=True) if np.isfinite(body[2]).all()]


def compute_links(joints: Array) -> tuple[Array, Array, Array]:
    """Compute the main links of several people; the head of this module gives the formulas.

    Args:
        joints: (N, J, 3) m, the first in the order of `skeleton.CMU15`, in any right-handed frame.

    Returns:
        Origins (N, 3) of `body` in m, origins (N, 3) of `torso` in m, and the axes (N, 3, 3) of `body` as unit
        vectors forward, left and up in columns. The axes of a person whose trunk or hips have no extent are NaN.
    """
    torso, body = (joints[:, pair].mean(axis=1) for pair in (_SHOULDERS, _HIPS))
    up, left = torso - body, joints[:, _HIPS[0]] - joints[:, _HIPS[1]]
    forward = np.cross(left, up)
    lengths = np.stack([np.linalg.norm(up, axis=1), np.linalg.norm(forward, axis=1)], axis=1)
    lengths[~(lengths.min(axis=1) > MIN_AXIS_LENGTH)] = np.nan
    up, forward = up / lengths[:, :1], forward / lengths[:, 1:]
    axes = np.stack([forward, np.cross(up, forward), up], axis=-1)
    return body, torso, axes


def make_suffix(person_id: str) -> str:
    """Return the id in characters that are valid in a frame's name: letters, digits and _."""
    return re.sub(r'\W', '_', person_id, flags=re.ASCII)


def _make_unique_suffix(person_id: str, used: set[str]) -> str:
    """Return the id in characters that are valid in a frame's name, unlike all in `used`, and add it to `used`."""
    valid = unique = make_suffix(person_id)
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
