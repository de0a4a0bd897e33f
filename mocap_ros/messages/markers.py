"""visualization_msgs/MarkerArray: spheres at the joints and lines along the bones of all people.

Each person has one SPHERE_LIST (namespace `joints`) and one LINE_LIST (namespace `bones`), because a marker for
each joint would cost ten times as much. Inferred joints, and bones that end in one, are pale and translucent. A
person who was not detected in the image and is predicted is grey.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.messages.cdr import Header, create_header, create_message, create_points, encode
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
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
PREDICTED_STYLE = _Style(0.0, 0.35)


class _MarkerShape(NamedTuple):
    """One of the markers that draw a person.

    Attributes:
        namespace: namespace of the marker.
        type: value of visualization_msgs/Marker.type.
        size_m: diameter of the spheres or width of the lines in m.
    """

    namespace: str
    type: int
    size_m: float


SHAPES = (
    _MarkerShape('joints', SPHERE_LIST, JOINT_DIAMETER_M),
    _MarkerShape('bones', LINE_LIST, BONE_WIDTH_M),
)


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
        header_message = create_header(header)
        markers = [
            _create_marker(header_message, shape.namespace, number, DELETE) for number in gone for shape in SHAPES
        ]
        for person in people:
            markers += _create_person_markers(header_message, person, self._assign_number(person.id), lifetime_s)
        return encode(create_message(MARKERS, markers=markers), MARKERS)

    def encode_clear(self, header: Header) -> bytes:
        """Encode a MarkerArray that deletes all markers, and forget all people."""
        self._number_by_id = {}
        markers = [_create_marker(create_header(header), '', 0, DELETE_ALL)]
        return encode(create_message(MARKERS, markers=markers), MARKERS)

    def _assign_number(self, person_id: str) -> int:
        """Return the number of a person; a new person gets the smallest free number."""
        if person_id not in self._number_by_id:
            taken = set(self._number_by_id.values())
            self._number_by_id[person_id] = next(n for n in count() if n not in taken)
        return self._number_by_id[person_id]


def _create_person_markers(header: Any, person: Person3D, number: int, lifetime_s: float) -> list[Any]:
    bones = np.array(CMU15.bones)
    inferred = np.asarray(person.inferred)
    points_and_inferred = {
        'joints': (person.joints, inferred),
        'bones': (person.joints[bones.ravel()], np.repeat(inferred[bones].any(axis=1), 2)),
    }
    seen_color = _create_color(number, SEEN_STYLE)
    inferred_color = _create_color(number, PREDICTED_STYLE if person.predicted else INFERRED_STYLE)
    markers = []
    for shape in SHAPES:
        positions, is_inferred = points_and_inferred[shape.namespace]
        marker = _create_marker(header, shape.namespace, number, ADD)
        marker.type = shape.type
        marker.scale.x = shape.size_m
        if shape.type == SPHERE_LIST:  # viewers warn about lines that have a height
            marker.scale.y = marker.scale.z = shape.size_m
        marker.points = create_points(positions)
        marker.colors = [inferred_color if i else seen_color for i in is_inferred]
        marker.color = seen_color
        seconds, nanoseconds = divmod(round(lifetime_s * NS_PER_S), NS_PER_S)
        marker.lifetime = create_message('builtin_interfaces/msg/Duration', sec=seconds, nanosec=nanoseconds)
        markers.append(marker)
    return markers


def _create_color(number: int, style: _Style) -> Any:
    """Create the colour of a person; neighbouring numbers get very different hues."""
    rgb = colorsys.hsv_to_rgb((FIRST_HUE + number * GOLDEN_RATIO) % 1, style.saturation, BRIGHTNESS)
    return create_message('std_msgs/msg/ColorRGBA', **dict(zip('rgb', rgb, strict=True)), a=style.opacity)


def _create_marker(header: Any, namespace: str, number: int, action: int) -> Any:
    """Create a marker in which all but these fields are zero or empty."""

    def create_zeros(msgtype: str, **values: float) -> Any:
        return create_message(msgtype, **{'x': 0.0, 'y': 0.0, 'z': 0.0, **values})

    return create_message(
        'visualization_msgs/msg/Marker',
        header=header,
        ns=namespace,
        id=number,
        type=0,
        action=action,
        pose=create_message(
            'geometry_msgs/msg/Pose',
            position=create_zeros('geometry_msgs/msg/Point'),
            orientation=create_zeros('geometry_msgs/msg/Quaternion', w=1.0),
        ),
        scale=create_zeros('geometry_msgs/msg/Vector3'),
        color=create_message('std_msgs/msg/ColorRGBA', r=0.0, g=0.0, b=0.0, a=0.0),
        lifetime=create_message('builtin_interfaces/msg/Duration', sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource='',
        texture=create_message(
            'sensor_msgs/msg/CompressedImage', header=header, format='', data=np.zeros(0, np.uint8)
        ),
        uv_coordinates=[],
        text='',
        mesh_resource='',
        mesh_file=create_message('visualization_msgs/msg/MeshFile', filename='', data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )
