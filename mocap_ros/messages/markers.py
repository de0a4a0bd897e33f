# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""visualization_msgs/MarkerArray: spheres at the joints and lines along the bones of all people.

Each person has one SPHERE_LIST (namespace `joints`) and one LINE_LIST (namespace `bones`), because a marker for
each joint would cost ten times as much. Inferred joints, and bones that end in one, are pale and translucent. A
person who was not detected in the image and is predicted, or who is tentative, is grey and translucent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import numpy as np

from mocap_ros.geometry.rigid_transform import SAME_POSE
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.marker_writer import (
    LINE_LIST,
    SPHERE_LIST,
    Colors,
    MarkerStyle,
    MarkerWriter,
    choose_color,
    encode_removal_of_all,
)
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.messages.template import KEPT_TEMPLATES, MessageTemplate
from mocap_ros.people import Person3D
from mocap_ros.skeleton import Skeleton
from mocap_ros.units import NS_PER_S

JOINT_DIAMETER_M = 0.06  # chosen for the look: about a wrist
BONE_WIDTH_M = 0.025  # chosen for the look: thinner than the joints

# All styles are chosen for the look.
SEEN_STYLE = MarkerStyle(0.75, 1.0)
INFERRED_STYLE = MarkerStyle(0.3, 0.35)
UNCERTAIN_STYLE = MarkerStyle(0.0, 0.35)  # of people who are predicted or tentative


class _MarkerShape(NamedTuple):
    """One of the markers that draw a person.

    Attributes:
        namespace: namespace of the marker.
        type: value of visualization_msgs/Marker.type.
        scale: m, value of visualization_msgs/Marker.scale: the diameter of the spheres or the width of the lines.
    """

    namespace: str
    type: int
    scale: tuple[float, float, float]


JOINTS = _MarkerShape('joints', SPHERE_LIST, (JOINT_DIAMETER_M, JOINT_DIAMETER_M, JOINT_DIAMETER_M))
BONES = _MarkerShape('bones', LINE_LIST, (BONE_WIDTH_M, 0.0, 0.0))  # viewers warn about lines that have a height


class MarkerEncoder:
    """Encoder of the successive MarkerArrays of one topic.

    It remembers the people of the previous message. A person therefore keeps a marker number and a colour, and the
    markers of a person who is gone are deleted.
    """

    def __init__(self) -> None:
        self._number_by_id: dict[str, int] = {}

    @property
    def numbers(self) -> Mapping[str, int]:
        """Numbers of the people of the last message, by id."""
        return self._number_by_id

    def encode_update(self, header: Header, people: Sequence[Person3D], lifetime_s: float) -> bytes:
        """Encode a MarkerArray that shows these people and deletes the markers of all others.

        Args:
            header: time and frame of the image.
            people: all people in the image.
            lifetime_s: time in s after which a viewer removes the markers by itself, 0 for never.
        """
        present = {p.id for p in people}
        gone = [n for person_id, n in self._number_by_id.items() if person_id not in present]
        self._number_by_id = {person_id: n for person_id, n in self._number_by_id.items() if person_id in present}
        numbers = [self._assign_number(p.id) for p in people]
        stacked, lifetime_ns = stack_people(people), round(lifetime_s * NS_PER_S)
        template = _lay_out(header.frame_id, tuple(gone), tuple(numbers), stacked.skeleton, lifetime_ns)
        if not people:
            return template.fill(header.stamp_ns)
        colors = [_choose_colors(n, p.predicted, p.tentative) for n, p in zip(numbers, people, strict=True)]
        seen, inferred = np.array(colors).swapaxes(0, 1)
        bone_ends = np.array(stacked.skeleton.bone_ends).T
        is_inferred = np.array([p.inferred for p in people])
        is_bone_inferred = is_inferred[:, bone_ends].any(axis=2).repeat(2, axis=1)
        is_pale = np.concatenate([is_inferred, is_bone_inferred], axis=1)
        return template.fill(
            header.stamp_ns,
            look=np.tile([*SAME_POSE, *JOINTS.scale, *SAME_POSE, *BONES.scale], len(people)),
            color=seen.repeat(2, axis=0),
            points=np.concatenate([stacked.joints, stacked.joints[:, bone_ends.ravel()]], axis=1),
            colors=np.where(is_pale[..., None], inferred[:, None], seen[:, None]),
        )

    def encode_clear(self, header: Header) -> bytes:
        """Encode a MarkerArray that deletes all markers, and forget all people."""
        self._number_by_id = {}
        return encode_removal_of_all(header)

    def _assign_number(self, person_id: str) -> int:
        """Return the number of a person; a new person gets the smallest free number."""
        if person_id not in self._number_by_id:
            taken = set(self._number_by_id.values())
            self._number_by_id[person_id] = next(n for n in count() if n not in taken)
        return self._number_by_id[person_id]


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(
    frame_id: str, gone: tuple[int, ...], numbers: tuple[int, ...], skeleton: Skeleton, lifetime_ns: int
) -> MessageTemplate:
    """Return the template of the two markers of each person.

    Args:
        frame_id: frame of the markers.
        gone: numbers of people whose markers are deleted.
        numbers: numbers of people who are shown.
        skeleton: names and order of their joints, and the bones between them.
        lifetime_ns: ns, time after which a viewer removes the markers by itself.
    """
    writer = MarkerWriter(frame_id, 2 * (len(gone) + len(numbers)), lifetime_ns)
    for number in gone:
        for shape in (JOINTS, BONES):
            writer.add_removal(shape.namespace, number)
    for number in numbers:
        for shape, points in ((JOINTS, len(skeleton.joints)), (BONES, 2 * len(skeleton.bones))):
            writer.add_shape(shape.namespace, number, shape.type, points, is_colored=True)
    return writer.finish_template()


def _choose_colors(number: int, is_predicted: bool, is_tentative: bool) -> tuple[Colors, Colors]:
    """Return the colours of a person's seen and inferred joints."""
    return (
        choose_color(number, UNCERTAIN_STYLE if is_tentative else SEEN_STYLE),
        choose_color(number, UNCERTAIN_STYLE if is_tentative or is_predicted else INFERRED_STYLE),
    )
