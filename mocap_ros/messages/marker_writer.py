# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""visualization_msgs/MarkerArray: colours of people, and a writer of markers that all have one header."""

from __future__ import annotations

import colorsys
import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rigid_transform import SAME_POSE
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, SINGLE, MessageTemplate, TemplateWriter
from mocap_ros.units import NS_PER_S

MARKERS = 'visualization_msgs/msg/MarkerArray'

# Values of visualization_msgs/Marker.type.
CYLINDER = 3
LINE_LIST = 5
SPHERE_LIST = 7

# Values of visualization_msgs/Marker.action.
ADD = 0
DELETE = 2
DELETE_ALL = 3

FIRST_HUE = 0.58  # of a turn around the colour circle; chosen for the look: blue
GOLDEN_RATIO = 0.618034  # of a turn between the hues of two numbers, which keeps the hues of all numbers apart
BRIGHTNESS = 0.95  # chosen for the look

Array = NDArray[np.float64]
Colors = NDArray[np.float32]  # (..., 4) red, green, blue and alpha in [0, 1]

# Groups of fields of a visualization_msgs/Marker.
_NUMBERS = struct.Struct('<iii')  # id, type, action
_LOOK = struct.Struct('<7d3d4f')  # pose, scale, color
_NO_LOOK = _LOOK.pack(*SAME_POSE, *[0.0] * (3 + 4))
_LIFE = struct.Struct('<iI?3x')  # lifetime, frame_locked
_NO_TEXT = b'\1\0\0\0\0\0\0\0'  # an empty string, padded
_NO_ELEMENTS = bytes(4)  # an empty sequence
# The fields after texture.header: texture.format and .data, uv_coordinates, text, mesh_resource,
# mesh_file.filename and .data, mesh_use_embedded_materials.
_NO_MESH = b''.join([_NO_TEXT, *[_NO_ELEMENTS] * 2, *[_NO_TEXT] * 3, _NO_ELEMENTS, b'\0'])


class MarkerStyle(NamedTuple):
    """How something is coloured.

    Attributes:
        saturation: saturation of the colour in [0, 1].
        opacity: alpha of the colour in [0, 1].
    """

    saturation: float
    opacity: float


class AlikeMarkers(NamedTuple):
    """N markers of one type with P points each.

    Attributes:
        namespace: of all of them.
        type: value of visualization_msgs/Marker.type.
        numbers: (N,) value of visualization_msgs/Marker.id.
        poses: (N, 7) m, position, and the quaternion x, y, z, w.
        scales: (N, 3) m, values of visualization_msgs/Marker.scale.
        colors: (N, 4) colours.
        points: (N, P, 3) m.
    """

    namespace: str
    type: int
    numbers: NDArray[np.int_]
    poses: Array
    scales: Array
    colors: Colors
    points: Array


class MarkerWriter(TemplateWriter):
    """Writer of the template of a MarkerArray, all markers of which have one header.

    The fields of the template are `look` (pose and scale), `color`, `points` and `colors` (of the points) of all
    markers that are shown, in their order.

    Args:
        frame_id: frame of the markers.
        number_of_markers: the number of markers that will follow.
        lifetime_ns: ns, time after which a viewer removes the markers by itself, 0 for never.
    """

    def __init__(self, frame_id: str, number_of_markers: int, lifetime_ns: int = 0) -> None:
        super().__init__()
        self.add_count(number_of_markers)
        self._frame_id, self._life = frame_id, _LIFE.pack(*divmod(lifetime_ns, NS_PER_S), False)

    def add_shape(self, namespace: str, number: int, type_: int, points: int, *, is_colored: bool = False) -> None:
        """Append a marker that is shown.

        Args:
            namespace: namespace of the marker.
            number: value of visualization_msgs/Marker.id.
            type_: value of visualization_msgs/Marker.type.
            points: number of its points.
            is_colored: whether each point has a colour of its own.
        """
        self._begin(namespace, number, type_, ADD)
        self.add_numbers('look', DOUBLE, 7 + 3)
        self.add_numbers('color', SINGLE, 4)
        self.add(4, self._life)
        self.add_number_sequence('points', DOUBLE, points, 3)
        self.add_number_sequence('colors', SINGLE, points if is_colored else 0, 4)
        self._end()

    def add_removal(self, namespace: str, number: int, action: int = DELETE) -> None:
        """Append a marker that removes one, or all with `DELETE_ALL`; its other fields are zero or empty."""
        self._begin(namespace, number, 0, action)
        self.add(8, _NO_LOOK + _LIFE.pack(0, 0, False) + 2 * _NO_ELEMENTS)
        self._end()

    def _begin(self, namespace: str, number: int, type_: int, action: int) -> None:
        self.add_stamped(self._frame_id)
        self.add_text(namespace)
        self.add(4, _NUMBERS.pack(number, type_, action))

    def _end(self) -> None:
        self.add(4, _NO_TEXT)  # texture_resource
        self.add_stamped(self._frame_id)
        self.add(4, _NO_MESH)


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(
    frame_id: str,
    gone: tuple[tuple[str, int], ...],
    groups: tuple[tuple[str, int, tuple[int, ...], int], ...],
    lifetime_ns: int,
) -> MessageTemplate:
    """Return the template of markers.

    Args:
        frame_id: frame of the markers.
        gone: namespaces and numbers of those that are deleted.
        groups: namespace, type, numbers, and points of each, of some that are alike.
        lifetime_ns: ns, time after which a viewer removes them.
    """
    writer = MarkerWriter(frame_id, len(gone) + sum(len(numbers) for _, _, numbers, _ in groups), lifetime_ns)
    for namespace, number in gone:
        writer.add_removal(namespace, number)
    for namespace, type_, numbers, points in groups:
        for number in numbers:
            writer.add_shape(namespace, number, type_, points)
    return writer.finish_template()


def encode_removal_of_all(header: Header) -> bytes:
    """Encode a MarkerArray that deletes all markers of a topic."""
    writer = MarkerWriter(header.frame_id, 1)
    writer.add_removal('', 0, DELETE_ALL)
    return writer.finish_template().fill(header.stamp_ns)


class MarkerSeries:
    """Encoder of the successive MarkerArrays of a topic, which deletes the markers that are not there any more."""

    def __init__(self) -> None:
        self._shown: dict[str, set[int]] = {}  # numbers of the markers, by namespace

    def encode_update(self, header: Header, groups: Sequence[AlikeMarkers], lifetime_s: float) -> bytes:
        """Encode a MarkerArray that shows these markers alone.

        Args:
            header: time and frame of the image.
            groups: the markers.
            lifetime_s: s after which a viewer removes the markers by itself, 0 for never.
        """
        shown: dict[str, set[int]] = {}
        for group in groups:
            shown.setdefault(group.namespace, set()).update(group.numbers.tolist())
        gone = [(ns, n) for ns, numbers in self._shown.items() for n in sorted(numbers - shown.get(ns, set()))]
        self._shown = shown
        kept = [(g.namespace, g.type, tuple(g.numbers.tolist()), g.points.shape[1]) for g in groups]
        template = _lay_out(header.frame_id, tuple(gone), tuple(kept), round(lifetime_s * NS_PER_S))
        if not groups:
            return template.fill(header.stamp_ns)
        return template.fill(
            header.stamp_ns,
            look=np.concatenate([np.concatenate([g.poses, g.scales], axis=1) for g in groups]),
            color=np.concatenate([g.colors for g in groups]),
            points=np.concatenate([g.points.ravel() for g in groups]),
        )

    def encode_clear(self, header: Header) -> list[bytes]:
        """Encode a MarkerArray that deletes all markers, if there are some, and forget them."""
        if not any(self._shown.values()):
            return []
        self._shown = {}
        return [encode_removal_of_all(header)]


@lru_cache(maxsize=1000)  # more people than are ever seen at once, in a few styles
def choose_color(number: int, style: MarkerStyle) -> Colors:
    """Return the colour (4,) of a person in a style; neighbouring numbers get very different hues."""
    hue = (FIRST_HUE + number * GOLDEN_RATIO) % 1
    return np.array([*colorsys.hsv_to_rgb(hue, style.saturation, BRIGHTNESS), style.opacity], np.float32)
