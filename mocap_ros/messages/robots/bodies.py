# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ROS4HRI (REP-155): the ids of all bodies, and the kinematic model and the joint states of each.

The model is that of the package human_description: a trunk, a head, arms and legs with 20 joints, all links with x
forward, y to the left and z up where the joints are at 0. Let R_a(t) be a rotation about the axis a, s = 1 on the
left and -1 on the right, and e the unit vector of an axis. In the axes of the trunk, the unit vectors of the head
(from the shoulders' midpoint), upper arm, forearm, thigh and shin are

    head      R_x(r) R_z(y) R_y(-p) e_z
    upper arm A (-e_z),    forearm  A R_y(-e) (-e_z),    A = R_z(-s y) R_x(s p) R_z(s r)
    thigh     C (-e_z),    shin     C R_y(-k) (-e_z),    C = R_z(-y) R_x(s p) R_y(-r)

which give the angles: of the arm by its two directions, of the leg by the thigh and the axis of the knee, to which
both are at right angles. Where the knee is straight, the axis is that of the trunk; where an arm is, r is 0, and y
where it hangs down. The waist and the yaw of the
head are 0, for positions do not tell them. Angles may be beyond the limits of the model, which are not those of
dancers.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INPUT_INTS_1D,
    kernel,
)
from mocap_ros.messages.cdr import (
    Array,
    CdrWriter,
    Header,
    OutputMessage,
    create_message,
    encode,
)
from mocap_ros.messages.foreign.definitions import HRI_IDS
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, SeriesTemplate, TemplateWriter
from mocap_ros.messages.transforms import compute_links
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

JOINT_STATES = 'sensor_msgs/msg/JointState'
DESCRIPTION = 'std_msgs/msg/String'
BODIES = '/humans/bodies/'  # namespace of the topics
TRACKED = BODIES + 'tracked'
SIDES = {'l': 1.0, 'r': -1.0}  # s of the module
STRAIGHT_SINE = 0.05  # 1; sine of 3 degrees: of a straighter limb, the axis of its bending is noise
LIMB_RADIUS_M = 0.03  # m; of the cylinders that draw limbs, as in human_description
MAX_LENGTH_CHANGE = 0.1  # share of a length; a body that changes more is described again
CORE = len(CMU15.joints)  # joints of a person that the model is made of; they come first
MAX_ID_CHARACTERS = 200  # of a body's id; the middleware refuses names of topics of more than 247
EFFORT, SPEED = '1000', '0.5'  # limits that URDF demands; nobody drives these joints


class _Joint(NamedTuple):
    """A joint of the model and the link below it.

    Attributes:
        name: of the joint.
        link: name of the link.
        parent: name of the link above.
        axis: of a revolute joint; empty if fixed.
        limits: rad, least and largest angle.
        offset: name of the length, and the direction in which it is from the parent; empty where they coincide.
    """

    name: str
    link: str
    parent: str
    axis: str = ''
    limits: tuple[float, float] = (0.0, 0.0)
    offset: tuple[str, tuple[float, float, float]] = ('', (0.0, 0.0, 0.0))


def _list_joints() -> tuple[_Joint, ...]:
    """Return the joints of the model, parents first."""
    joints = [
        _Joint('waist', 'waist', 'body', '0 1 0', (-0.2, 1.0)),
        _Joint('torso', 'torso', 'waist', offset=('trunk', (0.0, 0.0, 1.0))),
        _Joint('r_head', 'r_head', 'torso', '1 0 0', (-1.0, 1.0)),
        _Joint('y_head', 'y_head', 'r_head', '0 0 1', (-1.4, 1.4)),
        _Joint('p_head', 'p_head', 'y_head', '0 -1 0', (-1.5, 1.5)),
        _Joint('head', 'head', 'p_head', offset=('head', (0.0, 0.0, 1.0))),
    ]
    for side, s in SIDES.items():
        shoulder, elbow, hip, knee = (f'{side}_{name}' for name in ('shoulder', 'elbow', 'hip', 'knee'))
        y_shoulder, p_shoulder, r_shoulder = (f'{side}_{a}_shoulder' for a in 'ypr')
        y_hip, p_hip, r_hip = (f'{side}_{a}_hip' for a in 'ypr')
        reflect, down = f'{s:g}', (0.0, 0.0, -1.0)
        joints += [
            _Joint(y_shoulder, y_shoulder, 'torso', f'0 0 {-s:g}', (-1.7, 1.1), ('shoulder', (0.0, s, 0.0))),
            _Joint(p_shoulder, p_shoulder, y_shoulder, f'{reflect} 0 0', (-0.4, 3.3)),
            _Joint(r_shoulder, shoulder, p_shoulder, f'0 0 {reflect}', (-1.7, 1.5)),
            _Joint(elbow, elbow, shoulder, '0 -1 0', (0.0, 2.5), ('upper_arm', down)),
            _Joint(f'{side}_wrist', f'{side}_wrist', elbow, offset=('forearm', down)),
            _Joint(y_hip, y_hip, 'body', '0 0 -1', (-0.1, 0.6), ('hip', (0.0, s, 0.0))),
            _Joint(p_hip, p_hip, y_hip, f'{reflect} 0 0', (-0.4, 3.3)),
            _Joint(r_hip, hip, p_hip, '0 -1 0', (-0.4, 0.7)),
            _Joint(knee, knee, hip, '0 -1 0', (-2.5, 0.0), ('thigh', down)),
            _Joint(f'{side}_ankle', f'{side}_ankle', knee, offset=('shin', down)),
        ]
    return tuple(joints)


JOINTS = _list_joints()
# lengths of the model
LENGTHS = ('trunk', 'head', 'shoulder', 'hip', 'upper_arm', 'forearm', 'thigh', 'shin')
MOVED_JOINTS = tuple(j.name for j in JOINTS if j.axis)  # in the order of the joint states
ANGLES = len(MOVED_JOINTS)
HEAD_ANGLES = np.array([MOVED_JOINTS.index(name) for name in ('r_head', 'p_head')])
# The angles of each side are y, p, r of the shoulder and the elbow, then y, p, r of the hip and the knee.
FIRST_LIMB_ANGLE = MOVED_JOINTS.index('l_y_shoulder')
ARM_ANGLES = MOVED_JOINTS.index('l_y_hip') - FIRST_LIMB_ANGLE
LIMB_ANGLES = MOVED_JOINTS.index('r_y_shoulder') - FIRST_LIMB_ANGLE


def _find(*names: str) -> NDArray[np.int64]:
    """Return the indices of joints of both sides (2, n), left first."""
    return np.array([[CMU15.index(side + name) for name in names] for side in SIDES])


# Joints of the model: a row for each side.
HEAD = CMU15.index('head')
ARMS, LEGS = _find('shoulder', 'elbow', 'wrist'), _find('hip', 'knee', 'ankle')
SHOULDERS, _HIPS = ARMS[:, 0].copy(), LEGS[:, 0].copy()  # contiguous, as constants of kernels must be
_MIDDLES = np.array([SHOULDERS, _HIPS])  # joints between which two further places are
_CHEST, _PELVIS = CORE, CORE + 1  # indices of these places, behind the joints
# Indices (2, 8, 2) of the two places between which each of the `LENGTHS` is on each side.
_ENDS = np.array(
    [
        [(_CHEST, _PELVIS), (HEAD, _CHEST), SHOULDERS, _HIPS, arm[:2], arm[1:], leg[:2], leg[1:]]
        for arm, leg in zip(ARMS, LEGS, strict=True)
    ]
)
_SHARES = np.array([0.5 if name in ('shoulder', 'hip') else 1.0 for name in LENGTHS])  # of what is between them
_NO_LENGTHS = np.full(len(LENGTHS), np.nan)  # of a body that was not described


def make_body_id(person_id: str) -> str:
    """Return an id that can be part of the names of topics and frames: a letter, then letters, digits and _.

    A longer one than `MAX_ID_CHARACTERS` is cut.
    """
    valid = re.sub(r'\W', '_', person_id, flags=re.ASCII)
    return (valid if valid[:1].isalpha() else f'p{valid}')[:MAX_ID_CHARACTERS]


class BodyNames:
    """Names of people as bodies or frames, which two people never share and nobody changes while present.

    Args:
        make_name: function that makes a valid name of an id.
    """

    def __init__(self, make_name: Callable[[str], str] = make_body_id) -> None:
        self._make_name = make_name
        self._names: dict[str, str] = {}  # by id

    def assign(self, ids: Sequence[str]) -> dict[str, str]:
        """Return the name of each of the people who are present; new ones get the first that is free."""
        names = {i: self._names[i] for i in ids if i in self._names}
        used = set(names.values())
        for person_id in ids:
            if person_id in names:
                continue
            plain = name = self._make_name(person_id)
            number = 1
            while name in used:
                number += 1
                name = f'{plain}_{number}'
            names[person_id] = name
            used.add(name)
        self._names = names
        return names


@kernel(FLOAT(FLOAT))
def _limit(value: float) -> float:
    """Return a sine or cosine without what rounding puts beyond 1."""
    return min(max(value, -1.0), 1.0)


@kernel(void(FLOATS_1D, INPUT_1D, INPUT_1D))
def _write_direction(out: Array, start: Array, end: Array) -> None:
    """Write the unit vector (3,) from one place to another; downwards where they are one."""
    length = math.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2)
    out[0], out[1], out[2] = 0.0, 0.0, -1.0
    if length > 0:
        for i in range(3):
            out[i] = (end[i] - start[i]) / length


@kernel(void(FLOATS_1D, INPUT_2D, INPUT_INTS_1D, FLOAT))
def _write_arm(out: Array, joints: Array, limb: NDArray[np.intp], sign: float) -> None:
    """Write the angles (4,) y, p, r of a shoulder and that of its elbow.

    Args:
        out: the angles in rad.
        joints: (15, 3) m, in the trunk's axes.
        limb: indices of shoulder, elbow and wrist.
        sign: s of the module.
    """
    upper, fore = np.empty(3), np.empty(3)
    _write_direction(upper, joints[limb[0]], joints[limb[1]])
    _write_direction(fore, joints[limb[1]], joints[limb[2]])
    pitch, yaw, roll = math.acos(_limit(-upper[2])), 0.0, 0.0
    if math.hypot(upper[0], upper[1]) > STRAIGHT_SINE:  # it neither hangs nor is held straight up
        yaw = math.atan2(upper[0], sign * upper[1])
    cosine, sine = math.cos(sign * yaw), math.sin(sign * yaw)
    x, y = cosine * fore[0] - sine * fore[1], sine * fore[0] + cosine * fore[1]
    cosine, sine = math.cos(-sign * pitch), math.sin(-sign * pitch)
    y, z = cosine * y - sine * fore[2], sine * y + cosine * fore[2]
    if math.hypot(x, y) > STRAIGHT_SINE:
        roll = math.atan2(sign * y, x)
    out[0], out[1], out[2], out[3] = yaw, pitch, roll, math.acos(_limit(-z))


@kernel(void(FLOATS_1D, INPUT_2D, INPUT_INTS_1D, FLOAT))
def _write_leg(out: Array, joints: Array, limb: NDArray[np.intp], sign: float) -> None:
    """Write the angles (4,) y, p, r of a hip and that of its knee; the arguments are those of `_write_arm`."""
    thigh, shin, axis = np.empty(3), np.empty(3), np.empty(3)
    _write_direction(thigh, joints[limb[0]], joints[limb[1]])
    _write_direction(shin, joints[limb[1]], joints[limb[2]])
    axis[0] = thigh[1] * shin[2] - thigh[2] * shin[1]
    axis[1] = thigh[2] * shin[0] - thigh[0] * shin[2]
    axis[2] = thigh[0] * shin[1] - thigh[1] * shin[0]
    if math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2) < STRAIGHT_SINE:
        axis[0], axis[1], axis[2] = -thigh[1] * thigh[0], 1 - thigh[1] * thigh[1], -thigh[1] * thigh[2]
    y = np.empty(3)  # with x and z the columns of R_z(-yaw) R_x(s pitch) R_y(-roll)
    _write_direction(y, np.zeros(3), axis)
    x2 = -(y[0] * thigh[1] - y[1] * thigh[0])
    out[0] = -math.atan2(-y[0], y[1])
    out[1] = sign * math.asin(_limit(y[2]))
    out[2] = -math.atan2(-x2, -thigh[2])
    out[3] = -math.acos(_limit(thigh[0] * shin[0] + thigh[1] * shin[1] + thigh[2] * shin[2]))


def compute_joint_states(joints: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the angles (N, A) in rad of the `MOVED_JOINTS` of bodies, and which bodies (N,) have a direction.

    Args:
        joints: (N, 15, 3) m, in the order of `skeleton.CMU15`, in any right-handed frame.
    """
    origin, _, axes = compute_links(joints)
    return _compute_angles((joints - origin[:, None]) @ axes), np.asarray(np.isfinite(axes).all(axis=(1, 2)))


@kernel(FLOATS_2D(INPUT_3D))
def _compute_angles(local: Array) -> Array:
    """Return the angles (N, A) in rad of bodies with joints (N, 15, 3) m in the axes of their trunks."""
    angles = np.zeros((len(local), ANGLES))
    shoulders, direction = np.empty(3), np.empty(3)
    for body in range(len(local)):
        joints, out = local[body], angles[body]
        for i in range(3):
            shoulders[i] = (joints[SHOULDERS[0], i] + joints[SHOULDERS[1], i]) / 2
        _write_direction(direction, shoulders, joints[HEAD])
        out[HEAD_ANGLES[0]] = math.atan2(-direction[1], direction[2])
        out[HEAD_ANGLES[1]] = -math.asin(_limit(direction[0]))
        for side in range(2):
            sign = 1.0 - 2.0 * side
            first = FIRST_LIMB_ANGLE + side * LIMB_ANGLES
            _write_arm(out[first : first + ARM_ANGLES], joints, ARMS[side], sign)
            _write_leg(out[first + ARM_ANGLES : first + LIMB_ANGLES], joints, LEGS[side], sign)
    return angles


def measure_lengths(joints: Array) -> Array:
    """Return the `LENGTHS` (N, 8) in m of bodies with joints (N, 15, 3) m; of limbs the means of both sides."""
    middles = (joints[:, _MIDDLES[:, 0]] + joints[:, _MIDDLES[:, 1]]) / 2
    places = np.concatenate([joints, middles], axis=1)
    left, right = np.linalg.norm(places[:, _ENDS[..., 0]] - places[:, _ENDS[..., 1]], axis=-1).swapaxes(0, 1)
    return np.asarray((left + right) / 2 * _SHARES)


def describe_body(body_id: str, measured: Array) -> str:
    """Return the URDF of a body with some `LENGTHS` (8,) in m; its links and joints end in `_` and the id."""
    lengths = dict(zip(LENGTHS, measured.tolist(), strict=True))
    robot = ET.Element('robot', name=f'human_{body_id}')
    for link in ('body', *(j.link for j in JOINTS)):
        element = ET.SubElement(robot, 'link', name=f'{link}_{body_id}')
        for name, direction in (j.offset for j in JOINTS if j.parent == link and j.offset[0]):
            visual = ET.SubElement(element, 'visual')
            middle = ' '.join(f'{lengths[name] / 2 * d:.4f}' for d in direction)
            ET.SubElement(visual, 'origin', xyz=middle, rpy=f'{np.pi / 2:.6f} 0 0' if direction[1] else '0 0 0')
            geometry = ET.SubElement(visual, 'geometry')
            ET.SubElement(geometry, 'cylinder', length=f'{lengths[name]:.4f}', radius=f'{LIMB_RADIUS_M}')
    for joint in JOINTS:
        kind = 'revolute' if joint.axis else 'fixed'
        element = ET.SubElement(robot, 'joint', name=f'{joint.name}_{body_id}', type=kind)
        ET.SubElement(element, 'parent', link=f'{joint.parent}_{body_id}')
        ET.SubElement(element, 'child', link=f'{joint.link}_{body_id}')
        name, direction = joint.offset
        place = ' '.join(f'{lengths.get(name, 0.0) * d:.4f}' for d in direction)
        ET.SubElement(element, 'origin', xyz=place, rpy='0 0 0')
        if joint.axis:
            ET.SubElement(element, 'axis', xyz=joint.axis)
            low, high = (f'{limit:g}' for limit in joint.limits)
            ET.SubElement(element, 'limit', lower=low, upper=high, effort=EFFORT, velocity=SPEED)
    return '<?xml version="1.0"?>' + ET.tostring(robot, encoding='unicode')


class BodiesEncoder:
    """Encoder of the successive messages of all bodies; it remembers who was described."""

    def __init__(self) -> None:
        self._lengths: dict[str, Array] = {}  # of the bodies that were described, by name

    def encode_update(
        self, header: Header, people: Sequence[Person3D], names: Mapping[str, str]
    ) -> list[OutputMessage]:
        """Encode the ids, the joint states of each body, and the kinematic models of new or changed bodies.

        Args:
            header: time of the image.
            people: the people.
            names: name of each person as a body, by id.
        """
        stamp_ns, descriptions = header.stamp_ns, []
        joints = stack_people(people).joints[:, :CORE]
        angles, is_known = compute_joint_states(joints)
        ids = [names[p.id] for p, known in zip(people, is_known, strict=True) if known]
        all_lengths = measure_lengths(joints[is_known])
        described = np.array([self._lengths.get(i, _NO_LENGTHS) for i in ids]).reshape(-1, len(LENGTHS))
        is_described = (np.abs(all_lengths - described) <= MAX_LENGTH_CHANGE * described).all(axis=1)
        for i in np.flatnonzero(~is_described).tolist():
            self._lengths[ids[i]] = all_lengths[i]
            raw = encode_description(ids[i], all_lengths[i])
            descriptions.append(OutputMessage(f'{BODIES}{ids[i]}/urdf', DESCRIPTION, stamp_ns, raw))
        self._lengths = {body_id: self._lengths[body_id] for body_id in ids}
        raws = _lay_out_joint_states(tuple(ids)).fill(stamp_ns, position=angles[is_known])
        states = [
            OutputMessage(f'{BODIES}{body_id}/joint_states', JOINT_STATES, stamp_ns, raw)
            for body_id, raw in zip(ids, raws, strict=True)
        ]
        return [OutputMessage(TRACKED, HRI_IDS, stamp_ns, encode_tracked(header, ids)), *descriptions, *states]

    def encode_clear(self, header: Header) -> list[OutputMessage]:
        """Encode that no body is tracked, if there were some, and forget all."""
        return self.encode_update(header, [], {}) if self._lengths else []


def encode_tracked(header: Header, ids: Sequence[str]) -> bytes:
    """Encode the ids of all bodies in an image as an IdsList."""
    writer = CdrWriter()
    writer.add_header(header)
    writer.add_count(len(ids))
    for body_id in ids:
        writer.add_text(body_id)
    return writer.finish()


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out_joint_states(ids: tuple[str, ...]) -> SeriesTemplate:
    """Return the template of the JointState of each body; the frame of its header is the body's."""
    writer = TemplateWriter()
    for body_id in ids:
        writer.add_stamped(f'body_{body_id}')
        writer.add_count(ANGLES)
        for name in MOVED_JOINTS:
            writer.add_text(f'{name}_{body_id}')
        writer.add_number_sequence('position', DOUBLE, ANGLES)
        for _ in ('velocity', 'effort'):
            writer.add_count(0)
        writer.end_message()
    return writer.finish_series()


def encode_description(body_id: str, lengths: Array) -> bytes:
    """Encode the URDF of a body with some `LENGTHS` (8,) in m as a String."""
    return encode(create_message(DESCRIPTION, data=describe_body(body_id, lengths)), DESCRIPTION)
