# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""OpenSim's files: a model (.osim) with the bones and markers of a person, and a motion of its coordinates (.mot).

The model has the segments and the coordinates of `joint_angles`. Its bones have the person's median lengths. The
markers are the joints, with the names that they have in a TRC file of `trc`. It is a model of kinematics: the
masses are those of an adult of 75 kg (de Leva, J. Biomechanics 29, 1996, rounded), the moments of inertia those of
rods, and there are no muscles.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, SIDES, JointAngles
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

DOCUMENT_VERSION = '40000'  # of the XML format of OpenSim 4.0, which all later versions read
RANGE_DEG, RANGE_M = (
    360.0,
    1000.0,
)  # degrees and m; coordinates are not clamped to their range, which must be given
BODY_MASS_KG = 75.0  # kg, of the person in the table of masses
ROD_RADIUS_SHARE = 0.15  # radius of a segment over its length
DECIMALS = 6  # of lengths in m and angles in degrees: far finer than any reconstruction
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)  # axes of a segment: forward, up, right


class _Segment(NamedTuple):
    """A segment of the body, which is a body of the model, and the joint that connects it with its parent.

    Attributes:
        name: name of the body.
        parent: name of the parent body, `ground` for the pelvis.
        joint: name of the joint.
        turns: name and axis of each coordinate, in the order in which the segment is turned.
        origin: joint of the skeleton at which the segment begins.
        markers: joints of the skeleton that are fixed to the segment.
        mass_share: mass of the segment over that of the body.
    """

    name: str
    parent: str
    joint: str
    turns: tuple[tuple[str, Vector], ...]
    origin: str
    markers: tuple[str, ...]
    mass_share: float


def _list_limbs() -> tuple[_Segment, ...]:
    """Return the segments of arms and legs."""
    limbs = []
    for side, sign in SIDES.items():
        x, y = (sign, 0.0, 0.0), (0.0, sign, 0.0)
        thigh = ((f'hip_flexion_{side}', Z), (f'hip_adduction_{side}', x), (f'hip_rotation_{side}', y))
        arm = ((f'arm_flex_{side}', Z), (f'arm_add_{side}', x), (f'arm_rot_{side}', y))
        knee, elbow = ((f'knee_angle_{side}', (0.0, 0.0, -1.0)),), ((f'elbow_flex_{side}', Z),)
        limbs += [
            _Segment(f'femur_{side}', 'pelvis', f'hip_{side}', thigh, f'{side}hip', (f'{side}knee',), 0.14),
            _Segment(
                f'tibia_{side}', f'femur_{side}', f'knee_{side}', knee, f'{side}knee', (f'{side}ankle',), 0.06
            ),
            _Segment(
                f'humerus_{side}', 'torso', f'shoulder_{side}', arm, f'{side}shoulder', (f'{side}elbow',), 0.03
            ),
            _Segment(
                f'forearm_{side}',
                f'humerus_{side}',
                f'elbow_{side}',
                elbow,
                f'{side}elbow',
                (f'{side}wrist',),
                0.02,
            ),
        ]
    return tuple(limbs)


# The segments, parents first. A marker at the origin of a segment belongs to the parent.
SEGMENTS = (
    _Segment(
        'pelvis', 'ground', 'ground_pelvis', (('pelvis_rotation', Y), ('pelvis_list', X), ('pelvis_tilt', Z)),
        'pelvis', ('pelvis', 'lhip', 'rhip'), 0.11,
    ),
    _Segment(
        'torso', 'pelvis', 'lumbar', (('lumbar_extension', Z), ('lumbar_bending', X), ('lumbar_rotation', Y)),
        'pelvis', ('neck', 'lshoulder', 'rshoulder'), 0.32,
    ),
    _Segment('head', 'torso', 'neck', (('neck_extension', Z), ('neck_bending', X)), 'neck', ('head',), 0.07),
    *_list_limbs(),
)  # fmt: skip


def place_markers(joints: Array, angles: JointAngles) -> dict[str, Array]:
    """Return where each joint is in the axes of its segment.

    Args:
        joints: (F, 15, 3) m, y up, in the order of `skeleton.CMU15`.
        angles: the angles of these joints.

    Returns:
        The median position (3,) in m of each joint by its name: of joints at the end of a bone along the bone, of
        hips and shoulders in the axes of pelvis and torso.
    """
    at = {name: joints[:, i] for i, name in enumerate(CMU15.joints)}
    places: dict[str, Array] = {'pelvis': np.zeros(3)}
    for segment in SEGMENTS:
        for marker in segment.markers:
            offset = at[marker] - at[segment.origin]
            if segment.name == 'pelvis':
                places[marker] = np.median(angles.pelvis.inv().apply(offset), axis=0)
            elif segment.name == 'torso':
                places[marker] = np.median(angles.torso.inv().apply(offset), axis=0)
            else:
                length = float(np.median(np.linalg.norm(offset, axis=1)))
                places[marker] = np.array([0.0, length if marker == 'head' else -length, 0.0])
    return places


def save_mot(path: Path, angles: JointAngles, times_s: Array) -> None:
    """Write a motion of the model's coordinates.

    Args:
        path: path of the file.
        angles: angles of F frames.
        times_s: (F,) s.
    """
    lines = [
        'Coordinates',
        'version=1',
        f'nRows={len(times_s)}',
        f'nColumns={len(COORDINATES) + 1}',
        'inDegrees=yes',
        'endheader',
        '\t'.join(['time', *COORDINATES]),
    ]
    for time_s, row in zip(times_s, angles.values, strict=True):
        lines.append('\t'.join(f'{value:.{DECIMALS}f}' for value in (time_s, *row)))
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def save_osim(path: Path, name: str, places: dict[str, Array]) -> None:
    """Write the model of a person.

    Args:
        path: path of the file.
        name: name of the model.
        places: where each joint is in the axes of its segment, as `place_markers` returns it.
    """
    document = ET.Element('OpenSimDocument', Version=DOCUMENT_VERSION)
    model = ET.SubElement(document, 'Model', name=re.sub(r'[^A-Za-z0-9_.-]', '_', name))  # as OpenSim demands
    ET.SubElement(model, 'Ground', name='ground')
    _add(model, 'gravity', (0.0, -9.80665, 0.0))
    _add(model, 'length_units', 'meters')
    bodies, joints, markers = (_add_set(model, kind) for kind in ('BodySet', 'JointSet', 'MarkerSet'))
    for segment in SEGMENTS:
        _add_body(bodies, segment, places)
        _add_joint(joints, segment, places)
        for marker in segment.markers:
            element = ET.SubElement(markers, 'Marker', name=marker)
            _add(element, 'socket_parent_frame', f'/bodyset/{segment.name}')
            _add(element, 'location', places[marker])
            _add(element, 'fixed', 'true')
    ET.indent(document)
    ET.ElementTree(document).write(path, encoding='UTF-8', xml_declaration=True)


def _add(parent: ET.Element, tag: str, value: str | Sequence[float] | Array) -> None:
    """Add an element with a text or with numbers."""
    text = value if isinstance(value, str) else ' '.join(f'{v:.{DECIMALS}f}' for v in value)
    ET.SubElement(parent, tag).text = text


def _add_set(model: ET.Element, kind: str) -> ET.Element:
    """Add an empty set of objects and return the element that holds them."""
    return ET.SubElement(ET.SubElement(model, kind, name=kind.lower()), 'objects')


def _add_body(bodies: ET.Element, segment: _Segment, places: dict[str, Array]) -> None:
    """Add a segment's body, a rod from its origin to the mean of its markers."""
    end = np.mean([places[marker] for marker in segment.markers], axis=0)
    length = max(float(np.linalg.norm(end)), 0.1)
    mass = segment.mass_share * BODY_MASS_KG
    radius = ROD_RADIUS_SHARE * length
    across = mass * (length**2 / 12 + radius**2 / 4)
    element = ET.SubElement(bodies, 'Body', name=segment.name)
    _add(element, 'mass', f'{mass:.{DECIMALS}f}')
    _add(element, 'mass_center', end / 2)
    _add(element, 'inertia', (across, mass * radius**2 / 2, across, 0.0, 0.0, 0.0))


def _add_joint(joints: ET.Element, segment: _Segment, places: dict[str, Array]) -> None:
    """Add the joint between a segment and its parent."""
    joint = ET.SubElement(joints, 'CustomJoint', name=segment.joint)
    is_root = segment.parent == 'ground'
    parent_path = '/ground' if is_root else f'/bodyset/{segment.parent}'
    _add(joint, 'socket_parent_frame', 'parent_offset')
    _add(joint, 'socket_child_frame', 'child_offset')
    names = [name for name, _ in segment.turns] + (list(POSITIONS) if is_root else [])
    coordinates = ET.SubElement(joint, 'coordinates')
    for name in names:
        element = ET.SubElement(coordinates, 'Coordinate', name=name)
        limit = RANGE_M if name in POSITIONS else np.radians(RANGE_DEG)
        _add(element, 'range', (-limit, limit))
        _add(element, 'clamped', 'false')
    frames = ET.SubElement(joint, 'frames')
    for name, parent, place in (
        ('parent_offset', parent_path, np.zeros(3) if is_root else places[segment.origin]),
        ('child_offset', f'/bodyset/{segment.name}', np.zeros(3)),
    ):
        frame = ET.SubElement(frames, 'PhysicalOffsetFrame', name=name)
        _add(frame, 'socket_parent', parent)
        _add(frame, 'translation', place)
        _add(frame, 'orientation', np.zeros(3))
    transform = ET.SubElement(joint, 'SpatialTransform')
    axes = [axis for _, axis in segment.turns]
    unused = [axis for axis in (Z, X, Y) if not any(abs(np.dot(axis, used)) > 0 for used in axes)]
    turns = [*segment.turns, *(('', axis) for axis in unused)]
    moves = [(name if is_root else '', axis) for name, axis in zip(POSITIONS, (X, Y, Z), strict=True)]
    for kind, entries in (('rotation', turns), ('translation', moves)):
        for number, (name, axis) in enumerate(entries, 1):
            element = ET.SubElement(transform, 'TransformAxis', name=f'{kind}{number}')
            _add(element, 'coordinates', name)
            _add(element, 'axis', axis)
            if name:
                function = ET.SubElement(element, 'LinearFunction', name='function')
                _add(function, 'coefficients', (1.0, 0.0))
            else:
                function = ET.SubElement(element, 'Constant', name='function')
                _add(function, 'value', '0')
