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

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.messages.cdr import (
    Array,
    CdrWriter,
    Header,
    OutputMessage,
    create_message,
    encode,
    encode_text,
    pad,
)
from mocap_ros.messages.foreign.definitions import HRI_IDS
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


def make_body_id(person_id: str) -> str:
    """Return an id that can be part of the names of topics and frames: a letter, then letters, digits and _."""
    valid = re.sub(r'\W', '_', person_id, flags=re.ASCII)
    return valid if valid[:1].isalpha() else f'p{valid}'


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


def compute_joint_states(joints: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the angles (N, A) in rad of the `MOVED_JOINTS` of bodies, and which bodies (N,) have a direction.

    Args:
        joints: (N, 15, 3) m, in the order of `skeleton.CMU15`, in any right-handed frame.
    """
    origin, _, axes = compute_links(joints)
    local = (joints - origin[:, None]) @ axes
    angles = np.zeros((len(joints), len(MOVED_JOINTS)))
    at = {name: angles[:, i] for i, name in enumerate(MOVED_JOINTS)}
    shoulders = (_at(local, 'lshoulder') + _at(local, 'rshoulder')) / 2
    head = _unit(_at(local, 'head') - shoulders)
    at['p_head'][:] = -np.arcsin(head[:, 0].clip(-1, 1))
    at['r_head'][:] = np.arctan2(-head[:, 1], head[:, 2])
    for side, s in SIDES.items():
        upper, fore = _limb(local, side, 'shoulder', 'elbow'), _limb(local, side, 'elbow', 'wrist')
        thigh, shin = _limb(local, side, 'hip', 'knee'), _limb(local, side, 'knee', 'ankle')
        pitch = np.arccos((-upper[:, 2]).clip(-1, 1))
        hangs = np.hypot(upper[:, 0], upper[:, 1]) <= STRAIGHT_SINE  # or is held straight up
        yaw = np.where(hangs, 0.0, np.arctan2(upper[:, 0], s * upper[:, 1]))
        bent = _turn(_turn(fore, 2, s * yaw), 0, -s * pitch)
        straight = np.hypot(bent[:, 0], bent[:, 1]) <= STRAIGHT_SINE
        at[f'{side}_y_shoulder'][:], at[f'{side}_p_shoulder'][:] = yaw, pitch
        at[f'{side}_r_shoulder'][:] = np.where(straight, 0.0, np.arctan2(s * bent[:, 1], bent[:, 0]))
        at[f'{side}_elbow'][:] = np.arccos((-bent[:, 2]).clip(-1, 1))
        axis = _cross(thigh, shin)
        is_straight = np.linalg.norm(axis, axis=1, keepdims=True) < STRAIGHT_SINE
        y, z = _unit(np.where(is_straight, np.array([0.0, 1.0, 0.0]) - thigh[:, 1:2] * thigh, axis)), -thigh
        x = _cross(y, z)  # the columns of R_z(-yaw) R_x(s pitch) R_y(-roll)
        at[f'{side}_y_hip'][:] = -np.arctan2(-y[:, 0], y[:, 1])
        at[f'{side}_p_hip'][:] = s * np.arcsin(y[:, 2].clip(-1, 1))
        at[f'{side}_r_hip'][:] = -np.arctan2(-x[:, 2], z[:, 2])
        at[f'{side}_knee'][:] = -np.arccos((thigh * shin).sum(axis=1).clip(-1, 1))
    return angles, np.asarray(np.isfinite(axes).all(axis=(1, 2)))


def measure_lengths(joints: Array) -> Array:
    """Return the `LENGTHS` (N, 8) in m of bodies with joints (N, 15, 3) m; of limbs the means of both sides."""

    def between(start: Array, end: Array) -> Array:
        return np.asarray(np.linalg.norm(start - end, axis=1))

    def of_sides(start: str, end: str) -> Array:
        return np.asarray(sum(between(_at(joints, s + start), _at(joints, s + end)) for s in SIDES) / len(SIDES))

    shoulders = (_at(joints, 'lshoulder') + _at(joints, 'rshoulder')) / 2
    hips = (_at(joints, 'lhip') + _at(joints, 'rhip')) / 2
    lengths = {
        'trunk': between(shoulders, hips),
        'head': between(_at(joints, 'head'), shoulders),
        'shoulder': between(_at(joints, 'lshoulder'), _at(joints, 'rshoulder')) / 2,
        'hip': between(_at(joints, 'lhip'), _at(joints, 'rhip')) / 2,
        'upper_arm': of_sides('shoulder', 'elbow'),
        'forearm': of_sides('elbow', 'wrist'),
        'thigh': of_sides('hip', 'knee'),
        'shin': of_sides('knee', 'ankle'),
    }
    return np.stack([lengths[name] for name in LENGTHS], axis=1)


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
        stamp_ns = header.stamp_ns
        states, descriptions, ids = [], [], []
        joints = np.array([p.joints[:CORE] for p in people]).reshape(-1, CORE, 3)
        rows = zip(people, *compute_joint_states(joints), measure_lengths(joints), strict=True)
        for person, angles, is_known, lengths in rows:
            if not is_known:
                continue
            body_id = names[person.id]
            ids.append(body_id)
            raw = encode_joint_states(header, body_id, angles)
            states.append(OutputMessage(f'{BODIES}{body_id}/joint_states', JOINT_STATES, stamp_ns, raw))
            known = self._lengths.get(body_id)
            if known is None or (np.abs(lengths - known) > MAX_LENGTH_CHANGE * known).any():
                self._lengths[body_id] = lengths
                raw = encode_description(body_id, lengths)
                descriptions.append(OutputMessage(f'{BODIES}{body_id}/urdf', DESCRIPTION, stamp_ns, raw))
        self._lengths = {body_id: self._lengths[body_id] for body_id in ids}
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


def encode_joint_states(header: Header, body_id: str, angles: Array) -> bytes:
    """Encode the angles (A,) of a body's `MOVED_JOINTS` as a JointState; the frame of its header is the body's."""
    writer = CdrWriter()
    writer.add_header(Header(header.stamp_ns, f'body_{body_id}'))
    writer.add_count(len(angles))
    writer.add(4, _encode_names(body_id))
    writer.add_sequence(angles)
    for _ in ('velocity', 'effort'):
        writer.add_count(0)
    return writer.finish()


@lru_cache(maxsize=100)  # more bodies than are tracked at once
def _encode_names(body_id: str) -> bytes:
    """Return the names of the moved joints of a body as CDR, to be added at a multiple of 4 bytes."""
    return b''.join(pad(encode_text(f'{name}_{body_id}')) for name in MOVED_JOINTS)


def encode_description(body_id: str, lengths: Array) -> bytes:
    """Encode the URDF of a body with some `LENGTHS` (8,) in m as a String."""
    return encode(create_message(DESCRIPTION, data=describe_body(body_id, lengths)), DESCRIPTION)


def _at(joints: Array, name: str) -> Array:
    return np.asarray(joints[:, CMU15.index(name)])


def _limb(joints: Array, side: str, start: str, end: str) -> Array:
    """Return the directions (N, 3) from one joint to another of a side."""
    return _unit(_at(joints, side + end) - _at(joints, side + start))


def _unit(vectors: Array) -> Array:
    """Return vectors (N, 3) at unit length; downwards those that have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1.0), np.array([0.0, 0.0, -1.0]))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (N, 3); `numpy.cross` takes five times as long for a few."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _turn(vectors: Array, axis: int, angles: Array) -> Array:
    """Return vectors (N, 3) turned about a coordinate axis by angles (N,)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine, out = np.cos(angles), np.sin(angles), vectors.copy()
    out[:, first] = cosine * vectors[:, first] - sine * vectors[:, second]
    out[:, second] = sine * vectors[:, first] + cosine * vectors[:, second]
    return out
