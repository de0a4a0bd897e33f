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
from mocap_ros.messages.cdr import ENCAPSULATION, CdrWriter, Header, encode_header, encode_text, pad
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
# pose, scale, color, lifetime, frame_locked, number of points; then the points follow without a gap
_LOOK = struct.Struct('<7d3d4fiI?3xI')
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


class MarkerContent(NamedTuple):
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
    points: Array = np.zeros((0, 3))
    colors: Colors = np.zeros((0, 4), np.float32)


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


_NOTHING = MarkerContent()


class MarkerWriter(CdrWriter):
    """Writer of a MarkerArray, all markers of which have one header.

    Args:
        header: time and frame of the markers.
        number_of_markers: the number of markers that will follow.
    """

    def __init__(self, header: Header, number_of_markers: int) -> None:
        super().__init__()
        self.add_count(number_of_markers)
        self._header = pad(encode_header(header))
        self._end = _NO_TEXT + self._header + _NO_MESH  # from texture_resource on

    def add_marker(self, namespace: str, number: int, action: int, content: MarkerContent = _NOTHING) -> None:
        """Append a marker; all fields that have no argument are zero or empty."""
        type_, scale, color, lifetime_ns, points, colors = content
        self.add(4, self._header + pad(encode_text(namespace)) + _NUMBERS.pack(number, type_, action))
        lifetime = divmod(lifetime_ns, NS_PER_S)
        self.add(8, _LOOK.pack(*SAME_POSE, *scale, *color.tolist(), *lifetime, False, len(points)))
        self.add(1, points.tobytes())
        self.add_sequence(colors)
        self.add(4, self._end)

    def add_alike(self, markers: AlikeMarkers, lifetime_ns: int) -> None:
        """Append many markers at once, which takes a tenth of the time; the points have the colour of the whole.

        The numbers from the pose on begin at a multiple of 8 bytes, and what precedes them at a multiple of 4,
        so the gap before them is the same in all markers but the first, which begins where others end.
        """
        head = self._header + pad(encode_text(markers.namespace))
        for rows in (slice(0, 1), slice(1, None)):
            if len(markers.numbers[rows]):
                self.add(4, self._fill(markers, rows, head, self._find_gap(len(head)), lifetime_ns))

    def _find_gap(self, head_bytes: int) -> int:
        """Return the bytes between the numbers of the next marker and its pose."""
        begun = len(self._data) - len(ENCAPSULATION)
        return -(begun + -begun % 4 + head_bytes + _NUMBERS.size) % 8

    def _fill(self, markers: AlikeMarkers, rows: slice, head: bytes, gap: int, lifetime_ns: int) -> bytes:
        """Return some of the markers as CDR.

        Args:
            markers: the markers.
            rows: which of them.
            head: header and namespace.
            gap: bytes before the pose.
            lifetime_ns: ns, time after which a viewer removes them.
        """
        points = markers.points.shape[1]
        end = pad(self._end)  # the next marker begins at a multiple of 4 bytes
        record = np.dtype(
            [
                ('head', 'V', len(head)), ('number', '<i4'), ('type', '<i4'), ('action', '<i4'), ('gap', 'V', gap),
                ('pose', '<f8', 7), ('scale', '<f8', 3), ('color', '<f4', 4), ('lifetime', '<i4', 2),
                ('locked', '<u4'), ('count', '<u4'), ('points', '<f8', (points, 3)), ('colors', '<u4'),
                ('end', 'V', len(end)),
            ]
        )  # fmt: skip
        out = np.zeros(len(markers.numbers[rows]), record)
        out['head'], out['number'], out['type'] = np.void(head), markers.numbers[rows], markers.type
        out['pose'], out['scale'], out['color'] = markers.poses[rows], markers.scales[rows], markers.colors[rows]
        out['lifetime'], out['count'] = divmod(lifetime_ns, NS_PER_S), points
        out['points'], out['end'] = markers.points[rows], np.void(end)
        return out.tobytes()


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
        writer = MarkerWriter(header, len(gone) + sum(map(len, shown.values())))
        for namespace, number in gone:
            writer.add_marker(namespace, number, DELETE)
        for group in groups:
            writer.add_alike(group, round(lifetime_s * NS_PER_S))
        return writer.finish()

    def encode_clear(self, header: Header) -> list[bytes]:
        """Encode a MarkerArray that deletes all markers, if there are some, and forget them."""
        if not any(self._shown.values()):
            return []
        self._shown = {}
        writer = MarkerWriter(header, 1)
        writer.add_marker('', 0, DELETE_ALL)
        return [writer.finish()]


@lru_cache(maxsize=1000)  # more people than are ever seen at once, in a few styles
def choose_color(number: int, style: MarkerStyle) -> Colors:
    """Return the colour (4,) of a person in a style; neighbouring numbers get very different hues."""
    hue = (FIRST_HUE + number * GOLDEN_RATIO) % 1
    return np.array([*colorsys.hsv_to_rgb(hue, style.saturation, BRIGHTNESS), style.opacity], np.float32)
