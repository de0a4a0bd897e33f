# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ROS4HRI (REP-155): the ids of all bodies, and the kinematic model, the joint states and the posture of each.

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
head are 0, for positions do not show them. Angles may be beyond the limits of the model, which are not those of
dancers.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.bridges.seen import SeenPeople
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_POSTURE
from mocap_ros.messages.transforms import FrameNames, compute_links
from mocap_ros.skeleton import CMU15, CORE_COUNT

JOINT_STATES = 'sensor_msgs/msg/JointState'
DESCRIPTION = 'std_msgs/msg/String'
BODIES = '/humans/bodies/'  # namespace of the topics
TRACKED = BODIES + 'tracked'
SIDES = {'l': 1.0, 'r': -1.0}  # s of the module
LIMBS = ('shoulder', 'elbow'), ('elbow', 'wrist'), ('hip', 'knee'), ('knee', 'ankle')
STRAIGHT_SINE = 0.05  # 1; sine of 3 degrees: of a straighter limb, the axis of its bending is noise
LIMB_RADIUS_M = 0.03  # m; of the cylinders that draw limbs, as in human_description
MAX_LENGTH_CHANGE = 0.1  # share of a length; a body that changes more is described again
EFFORT, SPEED = '1000', '0.5'  # limits that URDF demands; no motor drives these joints


class Joint(NamedTuple):
    """A joint of the model and the link below it."""

    name: str  # of the joint
    link: str  # name of the link
    parent: str  # name of the link above
    axis: str = ''  # of a revolute joint; empty if fixed
    limits: tuple[float, float] = (0.0, 0.0)  # rad, least and largest angle
    # Name of the length, and the direction in which it is from the parent; empty where they coincide
    offset: tuple[str, tuple[float, float, float]] = ('', (0.0, 0.0, 0.0))


def _list_joints() -> tuple[Joint, ...]:
    joints = [
        Joint('waist', 'waist', 'body', '0 1 0', (-0.2, 1.0)),
        Joint('torso', 'torso', 'waist', offset=('trunk', (0.0, 0.0, 1.0))),
        Joint('r_head', 'r_head', 'torso', '1 0 0', (-1.0, 1.0)),
        Joint('y_head', 'y_head', 'r_head', '0 0 1', (-1.4, 1.4)),
        Joint('p_head', 'p_head', 'y_head', '0 -1 0', (-1.5, 1.5)),
        Joint('head', 'head', 'p_head', offset=('head', (0.0, 0.0, 1.0))),
    ]
    for side, s in SIDES.items():
        shoulder, elbow, hip, knee = (f'{side}_{name}' for name in ('shoulder', 'elbow', 'hip', 'knee'))
        y_shoulder, p_shoulder, r_shoulder = (f'{side}_{a}_shoulder' for a in 'ypr')
        y_hip, p_hip, r_hip = (f'{side}_{a}_hip' for a in 'ypr')
        reflect, down = f'{s:g}', (0.0, 0.0, -1.0)
        joints += [
            Joint(y_shoulder, y_shoulder, 'torso', f'0 0 {-s:g}', (-1.7, 1.1), ('shoulder', (0.0, s, 0.0))),
            Joint(p_shoulder, p_shoulder, y_shoulder, f'{reflect} 0 0', (-0.4, 3.3)),
            Joint(r_shoulder, shoulder, p_shoulder, f'0 0 {reflect}', (-1.7, 1.5)),
            Joint(elbow, elbow, shoulder, '0 -1 0', (0.0, 2.5), ('upper_arm', down)),
            Joint(f'{side}_wrist', f'{side}_wrist', elbow, offset=('forearm', down)),
            Joint(y_hip, y_hip, 'body', '0 0 -1', (-0.1, 0.6), ('hip', (0.0, s, 0.0))),
            Joint(p_hip, p_hip, y_hip, f'{reflect} 0 0', (-0.4, 3.3)),
            Joint(r_hip, hip, p_hip, '0 -1 0', (-0.4, 0.7)),
            Joint(knee, knee, hip, '0 -1 0', (-2.5, 0.0), ('thigh', down)),
            Joint(f'{side}_ankle', f'{side}_ankle', knee, offset=('shin', down)),
        ]
    return tuple(joints)


JOINTS = _list_joints()
# lengths of the model
LENGTHS = ('trunk', 'head', 'shoulder', 'hip', 'upper_arm', 'forearm', 'thigh', 'shin')
MOVED_JOINTS = tuple(j.name for j in JOINTS if j.axis)  # in the order of the joint states


def _unit(vectors: Array) -> Array:
    """Return vectors (N, 3) with length 1; downwards where they have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1.0), [0.0, 0.0, -1.0])


def _arc(function: Any, values: Array) -> Array:
    """Return the arcus of sines or cosines without what rounding adds beyond 1."""
    return np.asarray(function(np.clip(values, -1.0, 1.0)))


def _find_arm_angles(positions: dict[str, Array], side: str) -> Array:
    """Return the angles (N, 4) y, p, r of a shoulder and that of its elbow, from positions in the trunk's axes."""
    s = SIDES[side]
    shoulder, elbow, wrist = (positions[side + name] for name in ('shoulder', 'elbow', 'wrist'))
    upper, fore = _unit(elbow - shoulder), _unit(wrist - elbow)
    pitch = _arc(np.arccos, -upper[:, 2])
    is_level = np.hypot(upper[:, 0], upper[:, 1]) > STRAIGHT_SINE  # it neither hangs nor is held straight up
    yaw = np.where(is_level, np.arctan2(upper[:, 0], s * upper[:, 1]), 0.0)
    cosine, sine = np.cos(s * yaw), np.sin(s * yaw)
    x, y = cosine * fore[:, 0] - sine * fore[:, 1], sine * fore[:, 0] + cosine * fore[:, 1]
    cosine, sine = np.cos(-s * pitch), np.sin(-s * pitch)
    y, z = cosine * y - sine * fore[:, 2], sine * y + cosine * fore[:, 2]
    roll = np.where(np.hypot(x, y) > STRAIGHT_SINE, np.arctan2(s * y, x), 0.0)
    return np.stack([yaw, pitch, roll, _arc(np.arccos, -z)], axis=1)


def _find_leg_angles(positions: dict[str, Array], side: str) -> Array:
    """Return the angles (N, 4) y, p, r of a hip and that of its knee, from positions in the trunk's axes."""
    hip, knee, ankle = (positions[side + name] for name in ('hip', 'knee', 'ankle'))
    thigh, shin = _unit(knee - hip), _unit(ankle - knee)
    axis = np.cross(thigh, shin)
    is_bent = np.linalg.norm(axis, axis=1, keepdims=True) >= STRAIGHT_SINE
    y = _unit(np.where(is_bent, axis, [0.0, 1.0, 0.0] - thigh[:, 1:2] * thigh))
    x2 = y[:, 1] * thigh[:, 0] - y[:, 0] * thigh[:, 1]
    # y is the middle column of R_z(-yaw) R_x(s pitch) R_y(-roll), and x2 the last number of the first one
    return np.stack(
        [
            -np.arctan2(-y[:, 0], y[:, 1]),
            SIDES[side] * _arc(np.arcsin, y[:, 2]),
            -np.arctan2(-x2, -thigh[:, 2]),
            -_arc(np.arccos, (thigh * shin).sum(axis=1)),
        ],
        axis=1,
    )


def compute_joint_states(joints: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the angles (N, A) in rad of the `MOVED_JOINTS` of bodies, and which bodies (N,) have a direction.

    Joints (N, 15, 3) are in m, in the order of `skeleton.CMU15`, in any right-handed frame.
    """
    origin, _, axes = compute_links(joints)
    is_known = np.asarray(np.isfinite(axes).all(axis=(1, 2)))
    local = (joints - origin[:, None]) @ axes
    positions = dict(zip(CMU15.joints, local.swapaxes(0, 1), strict=True))
    head = _unit(positions['head'] - (positions['lshoulder'] + positions['rshoulder']) / 2)
    angles = np.zeros((len(joints), len(MOVED_JOINTS)))
    angles[:, MOVED_JOINTS.index('r_head')] = np.arctan2(-head[:, 1], head[:, 2])
    angles[:, MOVED_JOINTS.index('p_head')] = -_arc(np.arcsin, head[:, 0])
    for side in SIDES:
        arm, leg = (MOVED_JOINTS.index(f'{side}_y_{joint}') for joint in ('shoulder', 'hip'))
        angles[:, arm : arm + 4] = _find_arm_angles(positions, side)
        angles[:, leg : leg + 4] = _find_leg_angles(positions, side)
    return angles, is_known


def measure_lengths(joints: Array) -> Array:
    """Return the `LENGTHS` (N, 8) in m of bodies with joints (N, 15, 3) m; of limbs the means of both sides."""
    positions = dict(zip(CMU15.joints, joints.swapaxes(0, 1), strict=True))
    chest, pelvis = ((positions[f'l{name}'] + positions[f'r{name}']) / 2 for name in ('shoulder', 'hip'))

    def measure(start: Array, end: Array) -> Array:
        return np.asarray(np.linalg.norm(start - end, axis=1))

    limbs = [[measure(positions[s + start], positions[s + end]) for s in SIDES] for start, end in LIMBS]
    return np.stack(
        [
            measure(chest, pelvis),
            measure(positions['head'], chest),
            measure(positions['lshoulder'], positions['rshoulder']) / 2,
            measure(positions['lhip'], positions['rhip']) / 2,
            *((left + right) / 2 for left, right in limbs),
        ],
        axis=1,
    )


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
        origin = ' '.join(f'{lengths.get(name, 0.0) * d:.4f}' for d in direction)
        ET.SubElement(element, 'origin', xyz=origin, rpy='0 0 0')
        if joint.axis:
            ET.SubElement(element, 'axis', xyz=joint.axis)
            low, high = (f'{limit:g}' for limit in joint.limits)
            ET.SubElement(element, 'limit', lower=low, upper=high, effort=EFFORT, velocity=SPEED)
    return '<?xml version="1.0"?>' + ET.tostring(robot, encoding='unicode')


class BodiesConverter:
    """Converter of the people of successive messages; it remembers names, and who was described."""

    def __init__(self) -> None:
        self._names = FrameNames()
        self._lengths: dict[str, Array] = {}  # of the bodies that were described, by name

    def convert(self, people: SeenPeople) -> list[tuple[str, str, Any]]:
        """Return topic, type and content of the messages: ids, models of new or changed bodies, states.

        The frame of joint states is that of the body; postures have the numbers of `Posture`.
        """
        names = self._names.assign(people.ids)
        joints = people.joints[:, :CORE_COUNT]
        angles, is_known = compute_joint_states(joints)
        all_lengths, described = measure_lengths(joints), self._lengths
        self._lengths = {}
        models: list[tuple[str, str, Any]] = []
        states: list[tuple[str, str, Any]] = []
        for n in np.flatnonzero(is_known).tolist():
            body, lengths = names[people.ids[n]], all_lengths[n]
            before = described.get(body)
            if before is None or (np.abs(lengths - before) > MAX_LENGTH_CHANGE * before).any():
                models.append((f'{BODIES}{body}/urdf', DESCRIPTION, (describe_body(body, lengths),)))
                before = lengths
            self._lengths[body] = before
            state = {
                'header': Header(people.header.stamp_ns, f'body_{body}'),
                'name': [f'{name}_{body}' for name in MOVED_JOINTS],
                'position': angles[n],
            }
            states.append((f'{BODIES}{body}/joint_states', JOINT_STATES, state))
            states.append((f'{BODIES}{body}/posture', HRI_POSTURE, (people.header, people.posture[n])))
        tracked = {'header': people.header, 'ids': list(self._lengths)}
        return [(TRACKED, HRI_IDS, tracked), *models, *states]
