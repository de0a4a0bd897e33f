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
turned as the segment of the body that turns about it or holds it (`solvers.body_segments`): `l_shoulder_<id>` is
the left upper arm. Of somebody who stands upright with hanging arms, all have the axes of the body.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_2D, FLOATS_3D, INPUT_3D, kernel
from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.messages.cdr import Array, Header
from mocap_ros.messages.stacked_people import StackedPeople, stack_people
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, MessageTemplate, TemplateWriter
from mocap_ros.people import HIPS, Person3D
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, Skeleton

TRANSFORMS = 'tf2_msgs/msg/TFMessage'
ROOT_LINK = 'body'  # name of the root link in REP-155
TORSO_LINK = 'torso'  # name of the link between the shoulders
MIDDLE_LINKS = 'head', 'nose'  # joints of the middle of the body that are links
MIN_AXIS_LENGTH = 1e-6  # m (up) and m^2 (forward); guards the divisions by them, far under any real size

_SHOULDERS = CMU15.index('lshoulder'), CMU15.index('rshoulder')


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
_TRANSFORM_NUMBERS = 3 + 4  # translation, and the quaternion x, y, z, w
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])  # factors of a quaternion's components for the opposite rotation


CHILD_LINKS = _list_links(BODY26).names  # all links besides `body` that any skeleton has


class BodyLinks(NamedTuple):
    """The main links of N people, as of `compute_links`."""

    roots: Array
    torsos: Array
    axes: Array

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """(N,) True for people who have axes."""
        return np.asarray(np.isfinite(self.axes).all(axis=(1, 2)))


def encode_transforms(
    header: Header, people: Sequence[Person3D], prefix: str = '', names: Mapping[str, str] | None = None
) -> bytes:
    """Encode a TFMessage of all people who are reconstructed in metres.

    Args:
        header: time and frame of the image; its frame_id is the parent of every `body_<id>`.
        people: all people in the image; people who are reconstructed without a focal length are left out.
        prefix: text before the name of every link.
        names: what stands for `<id>` of each person, by id; None for the id.
    """
    stacked = _choose_placed(people) if header.frame_id else stack_people([])
    ids = stacked.ids if names is None else tuple([names[i] for i in stacked.ids])
    template = _lay_out(header.frame_id, ids, stacked.skeleton, prefix)
    if not stacked:
        return template.fill(header.stamp_ns)
    roots, torsos, axes = stacked.share(find_links)
    rotations, joints = stacked.share(compute_orientations), _list_links(stacked.skeleton).joints
    numbers = np.empty((len(stacked), 2 + len(joints), _TRANSFORM_NUMBERS))
    numbers[:, 0, :3], numbers[:, 0, 3:] = roots, rotations
    places = np.concatenate([torsos[:, None], stacked.joints[:, joints]], axis=1)
    numbers[:, 1:, :3] = (places - roots[:, None]) @ axes
    segments = np.array([p.orientation for p in stacked])[:, [_TORSO_SEGMENT, *joints]]
    turned = multiply_quaternions(rotations[:, None] * _CONJUGATE, segments)
    turned[~np.isfinite(turned).all(axis=2)] = NO_ROTATION
    numbers[:, 1:, 3:] = turned
    return template.fill(header.stamp_ns, transforms=numbers)


def _choose_placed(people: Sequence[Person3D]) -> StackedPeople:
    """Return the people who are reconstructed in metres and have axes."""
    stacked = stack_people(people)
    if not all(p.scale_known for p in stacked):
        stacked = stack_people([p for p in stacked if p.scale_known])
    is_placed = stacked.share(find_links).is_known
    return stacked if is_placed.all() else stack_people([p for p, i in zip(stacked, is_placed, strict=True) if i])


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, ids: tuple[str, ...], skeleton: Skeleton, prefix: str) -> MessageTemplate:
    """Return the template for people with some ids."""
    writer, links, used_ids = TemplateWriter(), _list_links(skeleton).names, set[str]()
    writer.add_count(len(ids) * (1 + len(links)))
    for person_id in ids:
        suffix = _make_unique_suffix(person_id, used_ids)
        body = f'{prefix}{ROOT_LINK}_{suffix}'
        for parent, child in ((frame_id, body), *((body, f'{prefix}{link}_{suffix}') for link in links)):
            writer.add_stamped(parent)
            writer.add_text(child)
            writer.add_numbers('transforms', DOUBLE, _TRANSFORM_NUMBERS)
    return writer.finish_template()


def find_links(people: StackedPeople) -> BodyLinks:
    """Return the main links of people."""
    return BodyLinks(*compute_links(people.joints))


def compute_orientations(people: StackedPeople) -> Array:
    """Return the quaternions x, y, z, w (N, 4) of bodies: x forward, y left, z up along the trunk.

    They are those of the links on /tf; that of a body whose axes are not known is no rotation.
    """
    links = people.share(find_links)
    rows = zip(links.axes, links.is_known, strict=True)
    found = [quaternion_from_rotation(axes) if is_known else NO_ROTATION for axes, is_known in rows]
    return np.array(found).reshape(-1, 4)


def compute_links(joints: Array) -> tuple[Array, Array, Array]:
    """Compute the main links of several people; the head of this module gives the formulas.

    Args:
        joints: (N, J, 3) m, the first in the order of `skeleton.CMU15`, in any right-handed frame.

    Returns:
        Origins (N, 3) of `body` in m, origins (N, 3) of `torso` in m, and the axes (N, 3, 3) of `body` as unit
        vectors forward, left and up in columns. The axes of a person whose trunk or hips have no extent are NaN.
    """
    joints = np.ascontiguousarray(joints[:, :CORE_COUNT], np.float64)
    roots, torsos, axes = (np.empty((len(joints), *shape)) for shape in ((3,), (3,), (3, 3)))
    _write_links(roots, torsos, axes, joints)
    return roots, torsos, axes


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_3D, INPUT_3D))
def _write_links(roots: Array, torsos: Array, axes: Array, joints: Array) -> None:
    """Write the main links of bodies with joints (N, 15, 3) m; the others are the results of `compute_links`."""
    for n in range(len(joints)):
        body, root, torso = joints[n], roots[n], torsos[n]
        for i in range(3):
            root[i] = (body[HIPS[0], i] + body[HIPS[1], i]) / 2
            torso[i] = (body[_SHOULDERS[0], i] + body[_SHOULDERS[1], i]) / 2
        z0, z1, z2 = torso[0] - root[0], torso[1] - root[1], torso[2] - root[2]
        l0, l1, l2 = (
            body[HIPS[0], 0] - body[HIPS[1], 0],
            body[HIPS[0], 1] - body[HIPS[1], 1],
            body[HIPS[0], 2] - body[HIPS[1], 2],
        )
        x0, x1, x2 = l1 * z2 - l2 * z1, l2 * z0 - l0 * z2, l0 * z1 - l1 * z0
        height, forward = math.sqrt(z0 * z0 + z1 * z1 + z2 * z2), math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
        if not min(height, forward) > MIN_AXIS_LENGTH:
            axes[n] = np.nan
            continue
        x0, x1, x2, z0, z1, z2 = x0 / forward, x1 / forward, x2 / forward, z0 / height, z1 / height, z2 / height
        axes[n, 0, 0], axes[n, 1, 0], axes[n, 2, 0] = x0, x1, x2
        axes[n, 0, 1], axes[n, 1, 1], axes[n, 2, 1] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
        axes[n, 0, 2], axes[n, 1, 2], axes[n, 2, 2] = z0, z1, z2


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
