"""visualization_msgs/MarkerArray: spheres at the joints and lines along the bones of all people.

Each person has one SPHERE_LIST (namespace `joints`) and one LINE_LIST (namespace `bones`), because a marker for
each joint would cost ten times as much. Inferred joints, and bones that end in one, are pale and translucent. A
person who was not detected in the image and is predicted, or who is tentative, is grey and translucent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import NamedTuple

import numpy as np

from mocap_ros.messages.cdr import Header
from mocap_ros.messages.marker_writer import (
    ADD,
    DELETE,
    DELETE_ALL,
    LINE_LIST,
    SPHERE_LIST,
    Colors,
    MarkerContent,
    MarkerStyle,
    MarkerWriter,
    choose_color,
)
from mocap_ros.people import Person3D
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
        writer = MarkerWriter(header, 2 * (len(gone) + len(people)))
        for number in gone:
            for shape in (JOINTS, BONES):
                writer.add_marker(shape.namespace, number, DELETE)
        for person in people:
            _add_person(writer, person, self._assign_number(person.id), round(lifetime_s * NS_PER_S))
        return writer.finish()

    def encode_clear(self, header: Header) -> bytes:
        """Encode a MarkerArray that deletes all markers, and forget all people."""
        self._number_by_id = {}
        writer = MarkerWriter(header, 1)
        writer.add_marker('', 0, DELETE_ALL)
        return writer.finish()

    def _assign_number(self, person_id: str) -> int:
        """Return the number of a person; a new person gets the smallest free number."""
        if person_id not in self._number_by_id:
            taken = set(self._number_by_id.values())
            self._number_by_id[person_id] = next(n for n in count() if n not in taken)
        return self._number_by_id[person_id]


def _add_person(writer: MarkerWriter, person: Person3D, number: int, lifetime_ns: int) -> None:
    """Append the two markers of a person."""
    seen_color, inferred_color = _choose_colors(number, person.predicted, person.tentative)
    bone_ends = np.array(person.skeleton.bone_ends).T.ravel()
    is_bone_inferred = person.inferred[bone_ends].reshape(-1, 2).any(axis=1).repeat(2)
    for shape, points, is_inferred in (
        (JOINTS, person.joints, person.inferred),
        (BONES, person.joints[bone_ends], is_bone_inferred),
    ):
        colors = np.where(is_inferred[:, None], inferred_color, seen_color)
        content = MarkerContent(shape.type, shape.scale, seen_color, lifetime_ns, points, colors)
        writer.add_marker(shape.namespace, number, ADD, content)


def _choose_colors(number: int, is_predicted: bool, is_tentative: bool) -> tuple[Colors, Colors]:
    """Return the colours of a person's seen and inferred joints."""
    return (
        choose_color(number, UNCERTAIN_STYLE if is_tentative else SEEN_STYLE),
        choose_color(number, UNCERTAIN_STYLE if is_tentative or is_predicted else INFERRED_STYLE),
    )
