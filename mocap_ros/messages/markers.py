"""Markers that draw the people: spheres at the joints and lines along the bones.

One SPHERE_LIST (ns `joints`) and one LINE_LIST (ns `bones`) a person, since a marker for each joint costs ten
times as much. Joints that were not seen, and bones that end in one, are pale and see-through; who was not detected
and is predicted is grey all over.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from itertools import count
from typing import Any

import numpy as np

from mocap_ros.messages.cdr import NS, Header, encode, new, new_header, new_points
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

MARKERS = 'visualization_msgs/msg/MarkerArray'


SPHERE_LIST, LINE_LIST = 7, 5


ADD, DELETE, DELETE_ALL = 0, 2, 3


JOINT_DIAMETER = 0.06


BONE_WIDTH = 0.025


SEEN, FILLED, PREDICTED = (0.75, 1.0), (0.3, 0.35), (0.0, 0.35)  # saturation and opacity


GOLDEN_RATIO = 0.618034


SHAPES = (('joints', SPHERE_LIST, JOINT_DIAMETER), ('bones', LINE_LIST, BONE_WIDTH))


class MarkerMemory:
    """Knows who is drawn, so that everyone keeps a number and a colour, and the lost are deleted."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def update(self, header: Header, people: Sequence[Person3D], lifetime: float) -> bytes:
        """A MarkerArray: the people of this frame, and DELETE for those who are there no more.

        Args:
            header: of the frame.
            people: everyone in it.
            lifetime: s after which a viewer removes the markers by itself; 0: never.
        """
        present = {p.id for p in people}
        gone = [n for name, n in self._numbers.items() if name not in present]
        self._numbers = {name: n for name, n in self._numbers.items() if name in present}
        frame = new_header(header)
        markers = [_marker(frame, ns, n, DELETE) for n in gone for ns, _, _ in SHAPES]
        for person in people:
            markers += _drawn(frame, person, self._number(person.id), lifetime)
        return encode(new(MARKERS, markers=markers), MARKERS)

    def clear(self, header: Header) -> bytes:
        """A MarkerArray that deletes everything; forgets everyone."""
        self._numbers = {}
        markers = [_marker(new_header(header), '', 0, DELETE_ALL)]
        return encode(new(MARKERS, markers=markers), MARKERS)

    def _number(self, name: str) -> int:
        if name not in self._numbers:
            taken = set(self._numbers.values())
            self._numbers[name] = next(n for n in count() if n not in taken)
        return self._numbers[name]


def _drawn(header: Any, person: Person3D, number: int, lifetime: float) -> list[Any]:
    bones = np.array(CMU15.bones)
    inferred = np.asarray(person.inferred)
    looks = {
        'joints': (person.joints, inferred),
        'bones': (person.joints[bones.ravel()], np.repeat(inferred[bones].any(axis=1), 2)),
    }
    seen, hidden = (_color(number, look) for look in (SEEN, PREDICTED if person.predicted else FILLED))
    markers = []
    for ns, shape, size in SHAPES:
        positions, pale = looks[ns]
        marker = _marker(header, ns, number, ADD)
        marker.type = shape
        marker.scale.x = size
        if shape == SPHERE_LIST:  # viewers warn of lines that have a height
            marker.scale.y = marker.scale.z = size
        marker.points = new_points(positions)
        marker.colors = [hidden if p else seen for p in pale]
        marker.color = seen
        seconds, nanoseconds = divmod(round(lifetime * NS), NS)
        marker.lifetime = new('builtin_interfaces/msg/Duration', sec=seconds, nanosec=nanoseconds)
        markers.append(marker)
    return markers


def _color(number: int, look: tuple[float, float]) -> Any:
    """Of a person; hues far apart for neighbouring numbers."""
    saturation, alpha = look
    rgb = colorsys.hsv_to_rgb((0.58 + number * GOLDEN_RATIO) % 1, saturation, 0.95)
    return new('std_msgs/msg/ColorRGBA', **dict(zip('rgb', rgb, strict=True)), a=alpha)


def _marker(header: Any, ns: str, number: int, action: int) -> Any:
    def zeros(msgtype: str, **values: float) -> Any:
        return new(msgtype, **{'x': 0.0, 'y': 0.0, 'z': 0.0, **values})

    return new(
        'visualization_msgs/msg/Marker',
        header=header,
        ns=ns,
        id=number,
        type=0,
        action=action,
        pose=new(
            'geometry_msgs/msg/Pose',
            position=zeros('geometry_msgs/msg/Point'),
            orientation=zeros('geometry_msgs/msg/Quaternion', w=1.0),
        ),
        scale=zeros('geometry_msgs/msg/Vector3'),
        color=new('std_msgs/msg/ColorRGBA', r=0.0, g=0.0, b=0.0, a=0.0),
        lifetime=new('builtin_interfaces/msg/Duration', sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource='',
        texture=new('sensor_msgs/msg/CompressedImage', header=header, format='', data=np.zeros(0, np.uint8)),
        uv_coordinates=[],
        text='',
        mesh_resource='',
        mesh_file=new('visualization_msgs/msg/MeshFile', filename='', data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )
