# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The people of a `skeletons` or `predictions` message as arrays, which is what all consumers read.

People who are tentative are left out, because a robot would act on them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import Header, read_stamp
from mocap_ros.messages.markers import PersonNumbers
from mocap_ros.messages.plain import decode_plain
from mocap_ros.messages.skeletons import PREDICTIONS, SKELETONS
from mocap_ros.messages.transforms import compute_links
from mocap_ros.skeleton import CMU15, CORE_COUNT, Skeleton, keypoint_layout

RELIABILITY_FADE_S = 1.0  # s; the reliability of a person who has not been seen for so long is a third
FLESH_M = 0.1  # m; how far a body reaches beyond its joints: half a trunk's depth, a hand beyond its wrist


@dataclass(frozen=True, eq=False)
class People:
    """The N people of an image, who all have the same J joints, in the frame of the header."""

    header: Header  # time of the image, and the frame of the people
    ids: tuple[str, ...] = ()  # their ids
    # Number of each person, which is that of the markers of the topic `markers` and of their colours
    numbers: tuple[int, ...] = ()
    skeleton: Skeleton = CMU15  # names and order of the joints
    joints: Array = field(default_factory=lambda: np.zeros((0, CORE_COUNT, 3)))  # (N, J, 3) m
    # (N, J) m, standard deviations of the joints; NaN if unknown
    std: Array = field(default_factory=lambda: np.zeros((0, CORE_COUNT)))
    roots: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (N, 3) m, between the hips
    # (N, 3) m/s, of the roots; 0 where unknown, as consumers take no NaN
    velocities: Array = field(default_factory=lambda: np.zeros((0, 3)))
    covariances: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))  # (N, 3, 3) m^2, of the roots
    unseen_for: Array = field(default_factory=lambda: np.zeros(0))  # (N,) s, time since a person was last seen
    # (N,) True for people who were not detected in the image
    predicted: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def compute_reliability(self) -> Array:
        """Return how sure it is that each person is there: 1 for who is seen, less the longer one is not."""
        return np.exp(-self.unseen_for / RELIABILITY_FADE_S)

    def compute_boxes(self) -> tuple[Array, Array]:
        """Return centres and sizes (N, 3) in m of the boxes around the joints and the flesh about them."""
        low, high = self.joints.min(axis=1) - FLESH_M, self.joints.max(axis=1) + FLESH_M
        return (low + high) / 2, high - low

    def compute_orientations(self) -> Array:
        """Return the quaternions x, y, z, w (N, 4) of the bodies: x forward, y left, z up along the trunk.

        They are those of the links on /tf; that of a body whose axes are not known is no rotation.
        """
        _, _, axes = compute_links(self.joints)
        found = [quaternion_from_rotation(a) if np.isfinite(a).all() else NO_ROTATION for a in axes]
        return np.array(found).reshape(-1, 4)


class PredictedPeople(NamedTuple):
    """The N people at a time after an image."""

    ahead: float  # s after the image
    numbers: tuple[int, ...]  # number of each person, as of `People`
    joints: Array  # (N, 15, 3) m


class Predictions(NamedTuple):
    """Where the people of an image will be, in the frame of the header."""

    header: Header
    times: tuple[PredictedPeople, ...] = ()


def read_people(raw: bytes, numbers: PersonNumbers) -> People:
    """Read a Skeleton3DArray; the numbers of new people are added to those so far."""
    message = decode_plain(raw, SKELETONS)
    numbers.keep([p.id for p in message.people])
    header = _read_header(message.header)
    people = [p for p in message.people if not p.tentative]
    if not people:
        return People(header)
    names = {p.skeleton for p in people}
    if len(names) > 1:
        raise InputError(f'people: skeletons {", ".join(sorted(names))}; expected one')
    with naming('people[0].skeleton'):
        skeleton = keypoint_layout(names.pop())
    joints = len(skeleton.joints)
    for i, person in enumerate(people):
        if len(person.joints) != joints or len(person.joint_std) != joints:
            raise InputError(
                f'people[{i}]: {len(person.joints)} joints, {len(person.joint_std)} joint_std; expected {joints}'
            )
    positions, roots = np.array([p.joints for p in people]), np.array([p.root for p in people])
    if not (np.isfinite(positions).all() and np.isfinite(roots).all()):
        raise InputError('people: joints that are not finite')
    return People(
        header,
        tuple(p.id for p in people),
        tuple(numbers.find(p.id) for p in people),
        skeleton,
        positions,
        np.array([p.joint_std for p in people], float),
        roots,
        np.nan_to_num([p.root_velocity for p in people]),
        np.array([p.root_covariance for p in people]).reshape(-1, 3, 3),
        np.array([p.unseen_for for p in people], float),
        np.array([p.predicted for p in people], bool),
    )


def read_predictions(raw: bytes, numbers: PersonNumbers) -> Predictions:
    """Read a Predictions message; the arguments and errors are those of `read_people`."""
    message = decode_plain(raw, PREDICTIONS)
    times = []
    for i, then in enumerate(message.times):
        if not 0 < then.ahead < np.inf:
            raise InputError(f'times[{i}].ahead: {then.ahead:g} s, expected more than 0')
        if any(len(p.joints) != CORE_COUNT for p in then.people):
            raise InputError(f'times[{i}]: people with other than {CORE_COUNT} joints')
        joints = np.array([p.joints for p in then.people]).reshape(-1, CORE_COUNT, 3)
        if not np.isfinite(joints).all():
            raise InputError(f'times[{i}]: joints that are not finite')
        times.append(PredictedPeople(then.ahead, tuple(numbers.find(p.id) for p in then.people), joints))
    return Predictions(_read_header(message.header), tuple(times))


def _read_header(header: Any) -> Header:
    return Header(read_stamp(header.stamp), header.frame_id)
