# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/BodyCapsulesArray: bodies as capsules, for distances.

A capsule is all that is nearer to the segment between two places of the body than its radius

    r = g + k s

with g half the thickness of the body part, s the larger standard deviation of its two ends (the root of the trace
of the covariance) and k of the part: so large that 95 of 100 parts of its volume are inside. The k were fitted to
training persons seen by four detectors, about whose true joints bodies were put (`benchmarks/robots.py` measures
it on others). A trunk needs little, as g is that of a heavy person; a hand, whose place is known least, most.

The whole body may be nearer or farther than it seems, as its height is not known. This is not in the radii but in
Skeleton3D.root_covariance: added to every capsule, it would make all of them thick in all directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Array, Header
from mocap_ros.messages.stacked_people import StackedPeople, stack_people
from mocap_ros.messages.template import BYTE, DOUBLE, KEPT_TEMPLATES, SINGLE, MessageTemplate, TemplateWriter
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, Skeleton

CAPSULES = MOCAP_ROS_MSGS + 'BodyCapsulesArray'


class BodyPart(NamedTuple):
    """A body part between two joints.

    Attributes:
        name: name of the part.
        start: joint at one end.
        end: joint at the other end.
        half_thickness_m: m, half the thickness of a tall and heavy adult, clothes included.
        spread: k of the module.
        beyond: how far the part reaches beyond its end, of the length between the ends.
    """

    name: str
    start: str
    end: str
    half_thickness_m: float
    spread: float
    beyond: float = 0.0


# The parts of a body. Thicknesses: a trunk is 0.3 m deep at most, a thigh 0.2 m, a shin and an upper arm 0.14 m, a
# forearm with a sleeve and a shoe 0.12 m, a hand 0.1 m, a head 0.24 m long.
_TRUNK = (
    BodyPart('head', 'neck', 'head', 0.12, 0.63),
    BodyPart('trunk', 'neck', 'pelvis', 0.15, 0.2),
    BodyPart('shoulders', 'lshoulder', 'rshoulder', 0.1, 0.2),
    BodyPart('pelvis', 'lhip', 'rhip', 0.14, 0.2),
)
_HALF_LIMBS = (
    BodyPart('upper_arm', 'shoulder', 'elbow', 0.07, 0.78),
    BodyPart('thigh', 'hip', 'knee', 0.1, 0.25),
)
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
    """The P body parts of a skeleton.

    Attributes:
        names: their names.
        start: (P,) index of the joint at one end.
        end: (P,) index of that at the other end.
        half_thickness: (P,) m, half thicknesses.
        spread: (P,) k of the module.
        beyond: (P, 1) how far a part reaches beyond its end, of the length between the ends.
    """

    names: tuple[str, ...]
    start: NDArray[np.intp]
    end: NDArray[np.intp]
    half_thickness: Array
    spread: Array
    beyond: Array


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
    """The P capsules of a body, or of each of N bodies, in the order of `list_body_parts`.

    Attributes:
        start: (..., P, 3) m, one end of each segment.
        end: (..., P, 3) m, the other end.
        radius: (..., P) m.
    """

    start: Array
    end: Array
    radius: Array


def compute_capsules(person: Person3D) -> Capsules:
    """Return the capsules of a person (formula of the module); unknown standard deviations count as 0."""
    return _place_capsules(person.joints, person.std, person.skeleton)


def compute_all_capsules(people: StackedPeople) -> Capsules:
    """Return the capsules of people, as of `compute_capsules`."""
    return _place_capsules(people.joints, people.std, people.skeleton)


def _place_capsules(joints: Array, std: Array, skeleton: Skeleton) -> Capsules:
    """Return the capsules about joints (..., J, 3) in m with standard deviations (..., J) in m."""
    parts = arrange_body_parts(skeleton)
    start, end = joints[..., parts.start, :], joints[..., parts.end, :]
    larger = np.fmax(std[..., parts.start], std[..., parts.end])
    larger[np.isnan(larger)] = 0.0
    return Capsules(start, end + parts.beyond * (end - start), parts.half_thickness + parts.spread * larger)


def encode_capsules(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the capsules of people; the arguments are those of `people.encode_people`."""
    stacked = stack_people(people)
    capsules = stacked.share(compute_all_capsules)
    return _lay_out(header.frame_id, stacked.ids, stacked.skeleton).fill(
        header.stamp_ns,
        start=capsules.start,
        end=capsules.end,
        radius=capsules.radius,
        predicted=[p.predicted for p in stacked],
    )


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, ids: tuple[str, ...], skeleton: Skeleton) -> MessageTemplate:
    """Return the template for people with some ids."""
    writer, names = TemplateWriter(), arrange_body_parts(skeleton).names
    writer.add_stamped(frame_id)
    writer.add_count(len(ids))
    for person_id in ids:
        writer.add_text(person_id)
        writer.add_count(len(names))
        for name in names:
            writer.add_text(name)
        writer.add_number_sequence('start', DOUBLE, len(names), 3)
        writer.add_number_sequence('end', DOUBLE, len(names), 3)
        writer.add_number_sequence('radius', SINGLE, len(names))
        writer.add_numbers('predicted', BYTE, 1)
    return writer.finish_template()
