"""visualization_msgs/MarkerArray: spheres at the joints and lines along the bones of all people.

Each person has one SPHERE_LIST (namespace `joints`) and one LINE_LIST (namespace `bones`), because a marker for
each joint would cost ten times as much. Inferred joints, and bones that end in one, are pale and translucent. A
person who was not detected in the image and is predicted, or who is tentative, is grey and translucent.
"""

from __future__ import annotations

import colorsys
import struct
from collections.abc import Sequence
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rigid_transform import SAME_POSE
from mocap_ros.messages.cdr import CdrWriter, Header, encode_header, encode_text, pad
from mocap_ros.people import Person3D
from mocap_ros.units import NS_PER_S

MARKERS = 'visualization_msgs/msg/MarkerArray'

# Values of visualization_msgs/Marker.type.
LINE_LIST = 5
SPHERE_LIST = 7

# Values of visualization_msgs/Marker.action.
ADD = 0
DELETE = 2
DELETE_ALL = 3

JOINT_DIAMETER_M = 0.06  # chosen for the look: about a wrist
BONE_WIDTH_M = 0.025  # chosen for the look: thinner than the joints

FIRST_HUE = 0.58  # of a turn around the colour circle; chosen for the look: blue
GOLDEN_RATIO = 0.618034  # of a turn between the hues of two numbers, which keeps the hues of all numbers apart
BRIGHTNESS = 0.95  # chosen for the look


class _Style(NamedTuple):
    """How a joint or bone is coloured.

    Attributes:
        saturation: saturation of the colour in [0, 1].
        opacity: alpha of the colour in [0, 1].
    """

    saturation: float
    opacity: float


# All styles are chosen for the look.
SEEN_STYLE = _Style(0.75, 1.0)
INFERRED_STYLE = _Style(0.3, 0.35)
UNCERTAIN_STYLE = _Style(0.0, 0.35)  # of people who are predicted or tentative


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

Colors = NDArray[np.float32]  # (..., 4) red, green, blue and alpha in [0, 1]

# Groups of fields of a visualization_msgs/Marker.
_NUMBERS = struct.Struct('<iii')  # id, type, action
# pose, scale, color, lifetime, frame_locked, number of points; then the points follow without a gap
_LOOK = struct.Struct('<7d3d4fiI?3xI')
_NO_TEXT = b'\1\0\0\0\0\0\0\0'  # an empty string, padded
_NO_ELEMENTS = bytes(4)  # an empty sequence
# The fields after texture.header: texture.format and .data, uv_coordinates, text, mesh_resource,
# mesh_file.filename and .data, mesh_use_embedded_materials.
_NO_MESH = b''.join([_NO_TEXT, *[_NO_ELEMENTS] * 2, *[_NO_TEXT] * 3, _NO_ELEMENTS, b'\0'])


class _Content(NamedTuple):
    """What a marker shows; by default nothing. Nobody writes into the arrays.

    Attributes:
        type: value of visualization_msgs/Marker.type.
        scale: m, value of visualization_msgs/Marker.scale.
        color: (4,) colour of the whole.
        lifetime_ns: ns, time after which a viewer removes the marker by itself, 0 for never.
        points: (N, 3) m.
        colors: (N, 4) colours of the points.
    """

    type: int = 0
    scale: tuple[float, float, float] = (0.0, 0.0, 0.0)
    color: Colors = np.zeros(4, np.float32)
    lifetime_ns: int = 0
    points: NDArray[np.float64] = np.zeros((0, 3))
    colors: Colors = np.zeros((0, 4), np.float32)


_NOTHING = _Content()


class _MarkerWriter(CdrWriter):
    """Writer of a MarkerArray, all markers of which have one header.

    Args:
        header: time and frame of the markers.
        number_of_markers: the number of calls of `add_marker` that will follow.
    """

    def __init__(self, header: Header, number_of_markers: int) -> None:
        super().__init__()
        self.add_count(number_of_markers)
        self._header = pad(encode_header(header))
        self._end = _NO_TEXT + self._header + _NO_MESH  # from texture_resource on

    def add_marker(self, namespace: str, number: int, action: int, content: _Content = _NOTHING) -> None:
        """Append a marker; all fields that have no argument are zero or empty."""
        type_, scale, color, lifetime_ns, points, colors = content
        self.add(4, self._header + pad(encode_text(namespace)) + _NUMBERS.pack(number, type_, action))
        lifetime = divmod(lifetime_ns, NS_PER_S)
        self.add(8, _LOOK.pack(*SAME_POSE, *scale, *color.tolist(), *lifetime, False, len(points)))
        self.add(1, points.tobytes())
        self.add_sequence(colors)
        self.add(4, self._end)


class MarkerEncoder:
    """Encoder of the successive MarkerArrays of one topic.

    It remembers the people of the previous message. A person therefore keeps a marker number and a colour, and the
    markers of a person who is gone are deleted.
    """

    def __init__(self) -> None:
        self._number_by_id: dict[str, int] = {}

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
        writer = _MarkerWriter(header, 2 * (len(gone) + len(people)))
        for number in gone:
            for shape in (JOINTS, BONES):
                writer.add_marker(shape.namespace, number, DELETE)
        for person in people:
            _add_person(writer, person, self._assign_number(person.id), round(lifetime_s * NS_PER_S))
        return writer.finish()

    def encode_clear(self, header: Header) -> bytes:
        """Encode a MarkerArray that deletes all markers, and forget all people."""
        self._number_by_id = {}
        writer = _MarkerWriter(header, 1)
        writer.add_marker('', 0, DELETE_ALL)
        return writer.finish()

    def _assign_number(self, person_id: str) -> int:
        """Return the number of a person; a new person gets the smallest free number."""
        if person_id not in self._number_by_id:
            taken = set(self._number_by_id.values())
            self._number_by_id[person_id] = next(n for n in count() if n not in taken)
        return self._number_by_id[person_id]


def _add_person(writer: _MarkerWriter, person: Person3D, number: int, lifetime_ns: int) -> None:
    """Append the two markers of a person."""
    seen_color, inferred_color = _choose_colors(number, person.predicted, person.tentative)
    bone_ends = np.array(person.skeleton.bone_ends).T.ravel()
    is_bone_inferred = person.inferred[bone_ends].reshape(-1, 2).any(axis=1).repeat(2)
    for shape, points, is_inferred in (
        (JOINTS, person.joints, person.inferred),
        (BONES, person.joints[bone_ends], is_bone_inferred),
    ):
        colors = np.where(is_inferred[:, None], inferred_color, seen_color)
        content = _Content(shape.type, shape.scale, seen_color, lifetime_ns, points, colors)
        writer.add_marker(shape.namespace, number, ADD, content)


@lru_cache(maxsize=1000)  # more people than are ever seen at once
def _choose_colors(number: int, is_predicted: bool, is_tentative: bool) -> tuple[Colors, Colors]:
    """Return the colours of a person's seen and inferred joints; neighbouring numbers get very different hues."""
    hue = (FIRST_HUE + number * GOLDEN_RATIO) % 1
    seen, inferred = (
        np.array([*colorsys.hsv_to_rgb(hue, style.saturation, BRIGHTNESS), style.opacity], np.float32)
        for style in (
            UNCERTAIN_STYLE if is_tentative else SEEN_STYLE,
            UNCERTAIN_STYLE if is_tentative or is_predicted else INFERRED_STYLE,
        )
    )
    return seen, inferred
