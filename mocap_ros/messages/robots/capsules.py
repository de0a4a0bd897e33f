"""mocap_ros_msgs/BodyCapsulesArray: bodies as capsules, for distances, and the same as markers.

A capsule is all that is nearer to the segment between two places of the body than its radius

    r = g + k std

with g the half girth of the body part, std the larger standard deviation of its two ends (the root of the trace of
the covariance), and k so that 95 of 100 true places are inside: the length of a vector of three independent normal
coordinates with variances std^2 / 3 is below k std with that probability, k = sqrt(chi2_3(0.95) / 3) = 1.614.

The whole body may be nearer or farther than it seems, as its height is not known. This is not in the radii but in
Skeleton3D.root_covariance: added to every capsule, it would make all of them thick in all directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Array, CdrWriter, Header
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

CAPSULES = MOCAP_ROS_MSGS + 'BodyCapsulesArray'
INSIDE_FACTOR = 1.614  # 1; k of 95 of 100 (formula of the module)
HAND_SHARE = 0.45  # of the forearm; a hand reaches so far beyond the wrist, its fingers half bent
FOOT_SHARE = 0.25  # of the shin; a foot reaches so far below the ankle


class BodyPart(NamedTuple):
    """A body part between two joints.

    Attributes:
        name: name of the part.
        start: joint at one end.
        end: joint at the other end.
        girth_m: m, half the thickness of a tall and heavy adult, clothes included.
        beyond: how far the part reaches beyond its end, of the length between the ends.
    """

    name: str
    start: str
    end: str
    girth_m: float
    beyond: float = 0.0


# The parts of a body. Half girths: a trunk is 0.3 m deep at most, a thigh 0.2 m, a shin and an upper arm 0.14 m, a
# forearm with a sleeve 0.12 m, a head 0.24 m long.
BODY_PARTS = (
    BodyPart('head', 'neck', 'head', 0.12),
    BodyPart('trunk', 'neck', 'pelvis', 0.15),
    BodyPart('shoulders', 'lshoulder', 'rshoulder', 0.1),
    BodyPart('pelvis', 'lhip', 'rhip', 0.14),
    *(
        part
        for side in 'lr'
        for part in (
            BodyPart(f'{side}_upper_arm', f'{side}shoulder', f'{side}elbow', 0.07),
            BodyPart(f'{side}_forearm', f'{side}elbow', f'{side}wrist', 0.06, HAND_SHARE),
            BodyPart(f'{side}_thigh', f'{side}hip', f'{side}knee', 0.1),
            BodyPart(f'{side}_shin', f'{side}knee', f'{side}ankle', 0.07, FOOT_SHARE),
        )
    ),
)
PART_NAMES = tuple(part.name for part in BODY_PARTS)
_START = np.array([CMU15.index(part.start) for part in BODY_PARTS])
_END = np.array([CMU15.index(part.end) for part in BODY_PARTS])
_GIRTH = np.array([part.girth_m for part in BODY_PARTS])
_BEYOND = np.array([part.beyond for part in BODY_PARTS])[:, None]


class Capsules(NamedTuple):
    """The P capsules of a body, in the order of `BODY_PARTS`.

    Attributes:
        start: (P, 3) m, one end of each segment.
        end: (P, 3) m, the other end.
        radius: (P,) m.
    """

    start: Array
    end: Array
    radius: Array


def compute_capsules(person: Person3D) -> Capsules:
    """Return the capsules of a person (formula of the module); unknown standard deviations count as 0."""
    start, end = person.joints[_START], person.joints[_END]
    std = np.nan_to_num(person.std)
    radius = _GIRTH + INSIDE_FACTOR * np.maximum(std[_START], std[_END])
    return Capsules(start, end + _BEYOND * (end - start), radius)


def encode_capsules(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the capsules of people; the arguments are those of `people.encode_people`."""
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(len(people))
    for person in people:
        capsules = compute_capsules(person)
        writer.add_text(person.id)
        writer.add_count(len(PART_NAMES))
        for name in PART_NAMES:
            writer.add_text(name)
        writer.add_sequence(capsules.start)
        writer.add_sequence(capsules.end)
        writer.add_sequence(capsules.radius.astype(np.float32))
        writer.add(1, bytes([person.predicted]))
    return writer.finish()
