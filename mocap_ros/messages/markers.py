# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages for viewers: people, and where they will be, as visualization_msgs/MarkerArray, and as PointCloud2.

Each person has one SPHERE_LIST of joints (namespace `joints`) and one LINE_LIST of bones (namespace `bones`),
because a marker for each joint would cost ten times as much. Inferred joints, and bones that end in one, are pale
and translucent. A person who was not detected in the image and is predicted, or who is tentative, is grey and
translucent.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.rigid_transform import SAME_POSE
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.plain import encode_plain
from mocap_ros.people import People, Person3D
from mocap_ros.units import NS_PER_S

MARKERS = 'visualization_msgs/msg/MarkerArray'
POINTS = 'sensor_msgs/msg/PointCloud2'

CYLINDER, LINE_LIST, SPHERE_LIST = 3, 5, 7  # values of visualization_msgs/Marker.type
ADD, DELETE, DELETE_ALL = 0, 2, 3  # values of visualization_msgs/Marker.action

FIRST_HUE = 0.58  # of a turn around the colour circle; chosen for the look: blue
GOLDEN_RATIO = 0.618034  # of a turn between the hues of two numbers, which keeps the hues of all numbers apart
BRIGHTNESS = 0.95  # chosen for the look

JOINT_SCALE_M = (0.06, 0.06, 0.06)  # diameter of the spheres, chosen for the look: about a wrist
BONE_SCALE_M = (0.025, 0.0, 0.0)  # width of the lines, chosen for the look; viewers warn about lines with a height

LIFETIME_S = 0.5  # s; after which a viewer removes the markers of a bridge by itself

DATATYPES = {'<f4': 7, '<u2': 4, '|u1': 2}  # sensor_msgs/PointField.datatype by NumPy's name of the type
POINT_DTYPE = np.dtype(
    {
        'names': ['x', 'y', 'z', 'std', 'person', 'joint', 'inferred'],
        'formats': ['<f4', '<f4', '<f4', '<f4', '<u2', 'u1', 'u1'],
    }
)
_FIELDS = [(name, (dtype, offset)) for name, (dtype, offset, *_) in (POINT_DTYPE.fields or {}).items()]

Colors = NDArray[np.float32]  # (..., 4) red, green, blue and alpha in [0, 1]


class MarkerStyle(NamedTuple):
    """Saturation and alpha of a colour in [0, 1]."""

    saturation: float
    opacity: float


# All styles are chosen for the look.
SEEN_STYLE = MarkerStyle(0.75, 1.0)
INFERRED_STYLE = MarkerStyle(0.3, 0.35)
UNCERTAIN_STYLE = MarkerStyle(0.0, 0.35)  # of people who are predicted or tentative


class Marker(NamedTuple):
    """A visualization_msgs/Marker; the fields that are not here are zero or empty."""

    namespace: str  # text before the number; both together are the name of the marker
    number: int
    type: int = 0
    scale: ArrayLike | None = None  # (3,) m
    color: ArrayLike | None = None
    points: Array | None = None  # (P, 3) m
    colors: Colors | None = None  # (P, 4) of each point; None where they have the colour of the whole
    pose: ArrayLike = SAME_POSE  # (7,) position in m, and the quaternion x, y, z, w
    action: int = ADD


def encode_markers(header: Header, markers: Sequence[Marker], lifetime_s: float = 0.0) -> bytes:
    """Encode a MarkerArray; a viewer removes what it shows after a lifetime in s by itself, 0 for never."""
    lifetime = divmod(round(lifetime_s * NS_PER_S), NS_PER_S)
    message = [
        {
            'header': header,
            'ns': marker.namespace,
            'id': marker.number,
            'type': marker.type,
            'action': marker.action,
            'pose': marker.pose,
            'scale': marker.scale,
            'color': marker.color,
            'lifetime': lifetime if marker.action == ADD else None,
            'points': marker.points,
            'colors': marker.colors,
        }
        for marker in markers
    ]
    return encode_plain({'markers': message}, MARKERS)


def show_markers(
    header: Header, shown: Sequence[Marker], before: Sequence[Marker], lifetime_s: float = LIFETIME_S
) -> bytes:
    """Encode a MarkerArray that shows these markers, and deletes those of the message before that are gone."""
    kept = {(marker.namespace, marker.number) for marker in shown}
    gone = sorted({(marker.namespace, marker.number) for marker in before} - kept)
    return encode_markers(header, [*(Marker(*name, action=DELETE) for name in gone), *shown], lifetime_s)


class PersonNumbers:
    """Small numbers of people, which they keep while they are there."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}  # by id

    def keep(self, ids: Sequence[str]) -> None:
        """Forget all others, and number those who are new."""
        self._numbers = {i: n for i, n in self._numbers.items() if i in set(ids)}
        for person_id in ids:
            self.find(person_id)

    def find(self, person_id: str) -> int:
        """Return the number of a person; a new one gets the smallest that is free."""
        if person_id not in self._numbers:
            taken = set(self._numbers.values())
            self._numbers[person_id] = next(n for n in count() if n not in taken)
        return self._numbers[person_id]


class MarkerEncoder:
    """Encoder of the successive MarkerArrays of the people of images.

    A person keeps a marker number and a colour while present.
    """

    def __init__(self) -> None:
        self._numbers = PersonNumbers()
        self._shown: list[Marker] = []

    def encode_update(self, header: Header, people: People, lifetime_s: float) -> bytes:
        """Encode a MarkerArray that shows these people, for `encode_markers`, and deletes those of all others."""
        self._numbers.keep(people.ids)
        before, self._shown = self._shown, [m for p in people for m in draw_person(p, self._numbers.find(p.id))]
        return show_markers(header, self._shown, before, lifetime_s)

    def encode_clear(self, header: Header) -> bytes:
        """Encode a MarkerArray that deletes all markers, and forget all people."""
        self._numbers.keep([])
        self._shown = []
        return encode_markers(header, [Marker('', 0, action=DELETE_ALL)])


def draw_person(person: Person3D, number: int) -> tuple[Marker, Marker]:
    """Return the markers of the joints and of the bones of a person who has this number."""
    seen = choose_color(number, UNCERTAIN_STYLE if person.tentative else SEEN_STYLE)
    is_uncertain = person.tentative or person.predicted
    inferred = choose_color(number, UNCERTAIN_STYLE if is_uncertain else INFERRED_STYLE)
    ends = np.array(person.skeleton.bone_ends).T
    is_pale = person.inferred[ends].any(axis=1).repeat(2)
    joints, lines = (np.where(pale[:, None], inferred, seen) for pale in (person.inferred, is_pale))
    return (
        Marker('joints', number, SPHERE_LIST, JOINT_SCALE_M, seen, person.joints, joints),
        Marker('bones', number, LINE_LIST, BONE_SCALE_M, seen, person.joints[ends.ravel()], lines),
    )


@lru_cache(maxsize=1000)  # more people than are ever seen at once, in a few styles
def choose_color(number: int, style: MarkerStyle) -> Colors:
    """Return the colour (4,) of a person in a style; neighbouring numbers get very different hues."""
    hue = (FIRST_HUE + number * GOLDEN_RATIO) % 1
    return np.array([*colorsys.hsv_to_rgb(hue, style.saturation, BRIGHTNESS), style.opacity], np.float32)


def encode_points(header: Header, people: People) -> bytes:
    """Encode the joints of all people as an unordered PointCloud2 (height 1), for viewers that show no markers.

    The fields of a point are
    - `x`, `y`, `z`: position in m,
    - `std`: standard deviation of the position in m,
    - `person`: index of the person in the Skeleton3DArray,
    - `joint`: index of the joint in the SkeletonDefinition,
    - `inferred`: 1 where the joint was not seen and the model inferred it, else 0.
    """
    cloud = np.zeros((len(people), len(people.skeleton.joints)), POINT_DTYPE)
    cloud['x'], cloud['y'], cloud['z'] = np.moveaxis(people.joints, -1, 0)
    cloud['std'], cloud['inferred'] = people.joint_std, people.inferred
    cloud['person'], cloud['joint'] = np.arange(len(people))[:, None], np.arange(len(people.skeleton.joints))
    message = {
        'header': header,
        'height': 1,
        'width': cloud.size,
        'fields': [(name, offset, DATATYPES[dtype.str], 1) for name, (dtype, offset) in _FIELDS],
        'point_step': POINT_DTYPE.itemsize,
        'row_step': POINT_DTYPE.itemsize * cloud.size,
        'data': np.frombuffer(cloud.tobytes(), np.uint8),
        'is_dense': True,
    }
    return encode_plain(message, POINTS)
