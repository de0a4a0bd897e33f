# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The people of a `skeletons` or `predictions` message as arrays, which is what all consumers read.

People who are tentative are left out, because a robot would act on them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.level import LEVEL_UP, MAX_CERTAIN_STD
from mocap_ros.geometry.rigid_transform import NO_ROTATION
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.cdr import Header, read_stamp
from mocap_ros.messages.markers import PersonNumbers
from mocap_ros.messages.plain import decode_plain
from mocap_ros.messages.skeletons import PREDICTIONS, decode_skeletons
from mocap_ros.messages.transforms import compute_links
from mocap_ros.people import People
from mocap_ros.skeleton import CORE_COUNT

RELIABILITY_FADE_S = 1.0  # s; the reliability of a person who has not been seen for so long is a third
MIN_SINE = 0.1  # of the angle between up and where somebody looks, who else looks along the vertical
FLESH_M = 0.1  # m; how far a body reaches beyond its joints: half a trunk's depth, a hand beyond its wrist

NO_HEADER = Header(0, '')  # ns and frame before the first message


@dataclass(frozen=True, eq=False)
class SeenPeople(People):
    """The people of an image, in the frame of the header."""

    header: Header = NO_HEADER  # time of the image, and the frame of the people
    # Number of each person, which is that of the markers of the topic `markers` and of their colours
    numbers: tuple[int, ...] = ()
    vertical: Array = field(
        default_factory=lambda: np.zeros(3)
    )  # unit vector upwards; zeros where it is not known
    vertical_std: float = math.nan  # rad

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

    def compute_headings(self) -> Array:
        """Return the directions forward (N, 3) of the bodies; zeros of a body whose axes are not known."""
        _, _, axes = compute_links(self.joints)
        return np.nan_to_num(axes[:, :, 0])

    def find_world_axes(self, ahead: Array) -> Array:
        """Return the axes left, up and ahead, in rows (3, 3), of a world in which somebody looks ahead (3,).

        Up is the vertical, or against y where it is not known.
        """
        is_known = self.vertical.any() and self.vertical_std <= MAX_CERTAIN_STD
        up = self.vertical / np.linalg.norm(self.vertical) if is_known else LEVEL_UP
        ahead = ahead if np.linalg.norm(np.cross(up, ahead)) > MIN_SINE else np.roll(up, 1)
        left = np.cross(up, ahead)
        left /= np.linalg.norm(left)
        return np.stack([left, up, np.cross(left, up)])


class NumberedPeople(NamedTuple):
    """The N people at a time after an image."""

    ahead: float  # s after the image
    numbers: tuple[int, ...]  # number of each person, as of `SeenPeople`
    joints: Array  # (N, 15, 3) m


class Predictions(NamedTuple):
    """Where the people of an image will be, in the frame of the header."""

    header: Header
    times: tuple[NumberedPeople, ...] = ()


def show_nobody(header: Header) -> SeenPeople:
    """Return an image without people."""
    return SeenPeople(**vars(People.none()), header=header)


def read_people(raw: bytes, numbers: PersonNumbers) -> SeenPeople:
    """Read a Skeleton3DArray; the numbers of new people are added to those so far."""
    message = decode_skeletons(raw, is_in_camera=False)
    numbers.keep(message.people.ids)
    people = message.people.certain
    if not np.isfinite(people.joints).all():
        raise InputError('people: joints that are not finite')
    return SeenPeople(
        **vars(people),
        header=message.header,
        numbers=tuple(map(numbers.find, people.ids)),
        vertical=message.vertical,
        vertical_std=message.vertical_std,
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
        times.append(NumberedPeople(then.ahead, tuple(numbers.find(p.id) for p in then.people), joints))
    return Predictions(Header(read_stamp(message.header.stamp), message.header.frame_id), tuple(times))
