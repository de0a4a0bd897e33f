# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/BodyCapsulesArray, and markers of the same for RViz and Foxglove: bodies as capsules.

A capsule is all that is nearer to the segment between two points of the body than its radius

    r = g + k s + q S

with g half the thickness of the body part, s the larger standard deviation of its two ends (the root of the trace
of the covariance) and k of the part: so large that 95 of 100 parts of its volume are inside where the root is in
its true place. A trunk needs little, as g is that of a heavy person; a hand, whose position is known least, most.
The whole body may be nearer or farther than it seems: S is the standard deviation of the root along the direction
in which it is known least, nearly the line of sight, and q so large that 95 of 100 parts of the body are inside as
published, in every row of posture, detector and distance. Both were fitted to training persons seen by models of
detectors, about whose true joints bodies were put (`benchmarks/robots.py` and `deviations.py` measure others).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.bridges.seen import SeenPeople
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS
from mocap_ros.messages.markers import CYLINDER, SPHERE_LIST, Marker, MarkerStyle, choose_color, show_markers
from mocap_ros.skeleton import BODY26, CMU15, Skeleton

CAPSULES = MOCAP_ROS_MSGS + 'BodyCapsulesArray'
CAPSULE_STYLE = MarkerStyle(0.75, 0.3)  # chosen for the look: the bones within can be seen
ROOT_SPREAD = 1.6  # q of the module
MIN_LENGTH_M = 1e-6  # m; between points that are nearer to each other there is no axis
MIN_QUATERNION = 1e-6  # 1; length of the quaternion before it is made 1, of an axis that points down


class BodyPart(NamedTuple):
    """A body part between two joints."""

    name: str  # name of the part
    start: str  # joint at one end
    end: str  # joint at the other end
    half_thickness_m: float  # m, half the thickness of a tall and heavy adult, clothes included
    spread: float  # k of the module
    beyond: float = 0.0  # how far the part reaches beyond its end, of the length between the ends


# The parts of a body. Thicknesses: a trunk is 0.3 m deep at most, a thigh 0.2 m, a shin and an upper arm 0.14 m, a
# forearm with a sleeve and a shoe 0.12 m, a hand 0.1 m, a head 0.24 m long.
_TRUNK = (
    BodyPart('head', 'neck', 'head', 0.12, 0.63),
    BodyPart('trunk', 'neck', 'pelvis', 0.15, 0.2),
    BodyPart('shoulders', 'lshoulder', 'rshoulder', 0.1, 0.2),
    BodyPart('pelvis', 'lhip', 'rhip', 0.14, 0.2),
)
_HALF_LIMBS = (BodyPart('upper_arm', 'shoulder', 'elbow', 0.07, 0.78), BodyPart('thigh', 'hip', 'knee', 0.1, 0.25))
# Without hands and feet, the forearm reaches beyond the wrist as far as a hand with half-bent fingers, and the
# shin beyond the ankle as far as the sole; toes are outside.
_ENDS_OF_CORE = (
    BodyPart('forearm', 'elbow', 'wrist', 0.06, 1.6, 0.45),
    BodyPart('shin', 'knee', 'ankle', 0.07, 0.8, 0.25),
)
# `lhand` is at the knuckles and `ltoe` at the ball of the foot: fingers and toes reach beyond.
_ENDS = (
    BodyPart('forearm', 'elbow', 'wrist', 0.06, 0.92),
    BodyPart('hand', 'wrist', 'hand', 0.05, 1.7, 0.6),
    BodyPart('shin', 'knee', 'ankle', 0.07, 0.65),
    BodyPart('foot', 'heel', 'toe', 0.06, 0.92, 0.25),
)


class PartArrays(NamedTuple):
    """The P body parts of a skeleton."""

    names: tuple[str, ...]  # their names
    start: NDArray[np.intp]  # (P,) index of the joint at one end
    end: NDArray[np.intp]  # (P,) index of that at the other end
    half_thickness: Array  # (P,) m, half thicknesses
    spread: Array  # (P,) k of the module
    beyond: Array  # (P, 1) how far a part reaches beyond its end, of the length between the ends


def list_body_parts(skeleton: Skeleton) -> tuple[BodyPart, ...]:
    """Return the parts of a body with the joints of a skeleton, the middle ones first."""
    limbs = (*_HALF_LIMBS, *(_ENDS if skeleton.name == BODY26.name else _ENDS_OF_CORE))
    sided = (
        part._replace(name=f'{side}_{part.name}', start=side + part.start, end=side + part.end)
        for side in 'lr'
        for part in limbs
    )
    return (*_TRUNK, *sided)


@lru_cache(maxsize=2)  # skeletons
def arrange_body_parts(skeleton: Skeleton) -> PartArrays:
    """Return the parts of a body with the joints of a skeleton, as arrays."""
    parts = list_body_parts(skeleton)
    return PartArrays(
        tuple(p.name for p in parts),
        np.array([skeleton.index(p.start) for p in parts]),
        np.array([skeleton.index(p.end) for p in parts]),
        np.array([p.half_thickness_m for p in parts]),
        np.array([p.spread for p in parts]),
        np.array([p.beyond for p in parts])[:, None],
    )


MAX_PARTS = max(len(list_body_parts(skeleton)) for skeleton in (CMU15, BODY26))


class Capsules(NamedTuple):
    """The P capsules of a body, or of each of N bodies, in the order of `list_body_parts`."""

    start: Array  # (..., P, 3) m, one end of each segment
    end: Array  # (..., P, 3) m, the other end
    radius: Array  # (..., P) m


def compute_capsules(joints: Array, std: Array, root_covariance: Array, skeleton: Skeleton) -> Capsules:
    """Return the capsules (formula of the module) about joints (..., J, 3) m of standard deviations (..., J) m.

    `root_covariance` (..., 3, 3) m^2 is that of the root. What is unknown of deviations counts as 0.
    """
    parts = arrange_body_parts(skeleton)
    start, end = joints[..., parts.start, :], joints[..., parts.end, :]
    larger = np.fmax(std[..., parts.start], std[..., parts.end])
    larger[np.isnan(larger)] = 0.0
    largest = np.linalg.eigvalsh(np.nan_to_num(root_covariance))[..., -1:]
    margin = parts.spread * larger + ROOT_SPREAD * np.sqrt(np.maximum(largest, 0.0))
    return Capsules(start, end + parts.beyond * (end - start), parts.half_thickness + margin)


def find_axis_poses(start: Array, end: Array) -> tuple[Array, Array]:
    """Return the lengths (..., P) in m of the segments between points (..., P, 3), and their poses (..., P, 7).

    A pose is the position of the middle in m and the quaternion x, y, z, w that turns the z axis to the axis a of
    the segment by the shortest way: (-a_y, a_x, 0, 1 + a_z), of unit length; half a turn about x where the axis
    points down.
    """
    length = np.linalg.norm(end - start, axis=-1)
    axis = (end - start) / np.maximum(length, MIN_LENGTH_M)[..., None]
    axis[length < MIN_LENGTH_M] = 0, 0, 1
    poses = np.zeros((*length.shape, 7))
    poses[..., :3] = (start + end) / 2
    poses[..., 3], poses[..., 4], poses[..., 6] = -axis[..., 1], axis[..., 0], 1 + axis[..., 2]
    norm = np.linalg.norm(poses[..., 3:], axis=-1)
    poses[norm < MIN_QUATERNION, 3:] = 1, 0, 0, 0
    poses[..., 3:] /= np.where(norm < MIN_QUATERNION, 1, norm)[..., None]
    return length, poses


def convert_capsules(people: SeenPeople) -> dict[str, Any]:
    """Return the capsules of people."""
    names = arrange_body_parts(people.skeleton).names
    capsules = compute_capsules(people.joints, people.joint_std, people.root_covariance, people.skeleton)
    return {
        'header': people.header,
        'people': [
            (person_id, names, start, end, radius, is_predicted)
            for person_id, start, end, radius, is_predicted in zip(
                people.ids, *capsules, people.predicted, strict=True
            )
        ],
    }


def convert_capsule_markers(people: SeenPeople, before: SeenPeople) -> bytes:
    """Return a CYLINDER and a SPHERE_LIST with a ball at each end (namespaces `cylinders` and `ends`) of each.

    They have the colours of the other markers; those of the people of the message before are deleted.
    """
    return show_markers(people.header, _list_markers(people), _list_markers(before))


def _list_markers(people: SeenPeople) -> list[Marker]:
    start, end, radius = compute_capsules(people.joints, people.joint_std, people.root_covariance, people.skeleton)
    length, poses = find_axis_poses(start, end)
    markers = []
    for n, person in enumerate(people.numbers):
        color = choose_color(person, CAPSULE_STYLE)
        for part, ball in enumerate(2 * radius[n]):
            number = person * MAX_PARTS + part
            ends = np.stack([start[n, part], end[n, part]])
            rod = ball, ball, length[n, part]
            markers.append(Marker('cylinders', number, CYLINDER, rod, color, pose=poses[n, part]))
            markers.append(Marker('ends', number, SPHERE_LIST, (ball, ball, ball), color, points=ends))
    return markers
