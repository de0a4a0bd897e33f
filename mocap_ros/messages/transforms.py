# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""tf2_msgs/TFMessage: the people as coordinate frames, the main links of REP-155 under its names.

The parent of `body_<id>` is the frame of the outputs. The origin of `body_<id>` lies between the hips; its axes
are

    z = unit(m - o)           up along the trunk, from the hips' midpoint o to the shoulders' midpoint m,
    x = unit((l - r) x z)     forward, where l and r are the left and the right hip,
    y = z x x                 to the left.

All other links are children of `body_<id>`: `torso_<id>` between the shoulders, `head_<id>`, the joints of the
limbs, such as `l_shoulder_<id>`, and toes, heels, hands, eyes, ears and nose where people have them. Each is
turned as the segment of the body that turns about it or holds it (`solvers.extremities`): `l_shoulder_<id>` is
the left upper arm. Of a person who stands upright with hanging arms, all have the axes of the body.

Beside the people, `mocap_world` is the world in which they stand (`runtime.output_frame.LiveWorld`). It is a child
of the frame of the outputs, since that, as of a camera on a robot, may have its one parent already.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import chain, count

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.rigid_transform import NO_ROTATION, RigidTransform
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.plain import encode_plain
from mocap_ros.people import People
from mocap_ros.skeleton import BODY26, CMU15, HIPS, Skeleton, find_roots

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
ROOT_LINK = 'body'  # name of the root link in REP-155
TORSO_LINK = 'torso'  # name of the link between the shoulders
WORLD_LINK = 'mocap_world'  # frame with z up, in which the floor is at z = 0
MIDDLE_LINKS = 'head', 'nose'  # joints of the middle of the body that are links
MAX_ID_CHARACTERS = 200  # of a name; the middleware refuses names of topics of more than 247
MIN_AXIS_LENGTH = 1e-6  # m (up) and m^2 (forward); guards the divisions by them, far under any real size

_SHOULDERS = CMU15.index('lshoulder'), CMU15.index('rshoulder')


@lru_cache(maxsize=2)  # skeletons
def _list_links(skeleton: Skeleton) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    """Return the names (L,) of a skeleton's links besides `body`, and the joints (L - 1,) of all but the torso."""
    pairs = skeleton.left_right_pairs
    sided = sorted(joint for pair in pairs for joint in pair)
    middle = [skeleton.joints.index(n) for n in MIDDLE_LINKS if n in skeleton.joints]
    names = [skeleton.joints[j] for j in middle] + [f'{n[0]}_{n[1:]}' for n in (skeleton.joints[j] for j in sided)]
    return (TORSO_LINK, *names), np.array([*middle, *sided])


_TORSO_SEGMENT = CMU15.index('neck')  # joint about which the torso turns (`solvers.extremities`)
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])  # factors of a quaternion's components for the opposite rotation

CHILD_LINKS = _list_links(BODY26)[0]  # all links besides `body` that any skeleton has


class FrameNames:
    """Names of people in those of frames or topics; two people share none, and it stays while they are present."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}  # by id

    def assign(self, ids: Sequence[str]) -> dict[str, str]:
        """Return the names of the people who are present by id; new ones get the first that is free."""
        names = {i: self._names[i] for i in ids if i in self._names}
        for person_id in ids:
            if person_id not in names:
                plain = make_body_id(person_id)
                choices = chain([plain], (f'{plain}_{n}' for n in count(2)))
                names[person_id] = next(name for name in choices if name not in names.values())
        self._names = names
        return names


def make_body_id(person_id: str) -> str:
    """Return an id that can be part of the names of topics and frames: a letter, then letters, digits and _.

    A longer one than `MAX_ID_CHARACTERS` is cut.
    """
    valid = re.sub(r'\W', '_', person_id, flags=re.ASCII)
    return (valid if valid[:1].isalpha() else f'p{valid}')[:MAX_ID_CHARACTERS]


def encode_transforms(
    header: Header,
    people: People,
    prefix: str = '',
    names: Mapping[str, str] | None = None,
    world: RigidTransform | None = None,
) -> bytes:
    """Encode a TFMessage of all people who are reconstructed in metres, and of their world.

    The frame of the header is the parent of every `body_<id>`. Names of links begin with `prefix`; `names` has
    what stands for `<id>`, by default what `FrameNames` makes of the ids. `world` leads from the world to the
    frame of the header, None where it is not known.
    """
    placed = people if people.is_scale_known and header.frame_id else People.none()
    links = zip(placed, *compute_links(placed.core), strict=True)
    known = [link for link in links if np.isfinite(link[-1]).all()]
    names = FrameNames().assign([p.id for p, *_ in known]) if names is None else names
    transforms: list[StampedTransform] = []
    if world is not None and header.frame_id:
        transforms.append((header, f'{prefix}{WORLD_LINK}', (*world.translation, *world.quaternion)))
    for person, root, torso, axes in known:
        link_names, joints = _list_links(person.skeleton)
        rotation = np.array(quaternion_from_rotation(axes))
        turned = multiply_quaternions(rotation * _CONJUGATE, person.joint_orientation[[_TORSO_SEGMENT, *joints]])
        turned[~np.isfinite(turned).all(axis=1)] = NO_ROTATION
        places = (np.vstack([torso, person.joints[joints]]) - root) @ axes
        suffix = names[person.id]
        body = Header(header.stamp_ns, f'{prefix}{ROOT_LINK}_{suffix}')
        transforms.append((header, body.frame_id, (*root, *rotation)))
        transforms += [
            (body, f'{prefix}{link}_{suffix}', row)
            for link, row in zip(link_names, np.hstack([places, turned]), strict=True)
        ]
    return write_transforms(transforms)


StampedTransform = tuple[Header, str, ArrayLike]  # stamp and parent, child, translation in m and x, y, z, w


def write_transforms(transforms: Sequence[StampedTransform]) -> bytes:
    """Encode transforms as a TFMessage."""
    return encode_plain({'transforms': transforms}, TRANSFORMS)


def compute_links(joints: Array) -> tuple[Array, Array, Array]:
    """Compute the main links of people with joints (N, J, 3) in m, the first those of `skeleton.CMU15`.

    Returns the origins (N, 3) of `body` and of `torso` in m, and the axes (N, 3, 3) of `body` as unit vectors
    forward, left and up in columns; they are NaN of a person whose trunk or hips have no extent.
    """
    (left, right), (left_shoulder, right_shoulder) = HIPS, _SHOULDERS
    roots = find_roots(joints)
    torsos = (joints[:, left_shoulder] + joints[:, right_shoulder]) / 2
    up = torsos - roots
    forward = np.cross(joints[:, left] - joints[:, right], up)
    lengths = np.linalg.norm([up, forward], axis=2, keepdims=True)
    lengths[:, ~(lengths > MIN_AXIS_LENGTH).all(axis=0)] = np.nan
    up, forward = up / lengths[0], forward / lengths[1]
    return roots, torsos, np.stack([forward, np.cross(up, forward), up], axis=2)
