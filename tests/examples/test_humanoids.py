# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples for humanoids: a robot of capsules with the joints of a Unitree G1, and SONIC's messages."""

import json
import runpy
import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.skeleton import BODY26
from tests.support.paths import ROOT, load_module

JOINTS = BODY26.joints
ROBOT = ROOT / 'tests' / 'data' / 'humanoid.xml'
# m; a person who stands and faces +x with hanging arms
STANDING = {
    'head': (0, 0, 1.6), 'neck': (0, 0, 1.45), 'pelvis': (0, 0, 0.95), 'lhip': (0, 0.1, 0.9),
    'lknee': (0, 0.1, 0.48), 'lankle': (0, 0.1, 0.08), 'lshoulder': (0, 0.18, 1.42),
    'lelbow': (0, 0.18, 1.12), 'lwrist': (0, 0.18, 0.86),
}  # fmt: skip


def stand(**turns: Rotation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return joints and orientations of a person who stands but for the turns of some segments."""
    joints = np.zeros((len(JOINTS), 3))
    for name, place in STANDING.items():
        joints[JOINTS.index(name)] = place
        if name.startswith('l'):
            joints[JOINTS.index('r' + name[1:])] = np.array(place) * (1, -1, 1)
    identity = Rotation.identity()
    return joints, np.array([turns.get(name, identity).as_quat() for name in JOINTS])


def turn(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


BENT = {'lelbow': turn('y', -90), 'relbow': turn('y', -90)}


@pytest.mark.parametrize(
    ('turns', 'angles'),
    [
        ({}, {}),
        ({'lshoulder': turn('x', 60), 'lelbow': turn('x', 60) * turn('y', -90)}, {'left_shoulder_roll_joint': 60}),
        ({'lelbow': turn('y', 0)}, {'left_elbow_joint': 90}),
        ({'rhip': turn('y', -50), 'rknee': turn('y', 0)}, {'right_hip_pitch_joint': -50, 'right_knee_joint': 50}),
    ],
)
def test_a_robot_takes_the_pose_of_a_person(turns: dict[str, Any], angles: dict[str, float]) -> None:
    mink = pytest.importorskip('mink')
    robot = load_module(ROOT / 'examples' / 'humanoid.py').Humanoid(str(ROBOT))
    for _ in range(5):
        row = robot.follow(*stand(**(BENT | turns)), mink.SE3.identity())
    found = dict(zip(robot.joint_names, np.degrees(row[7:]), strict=True))
    assert found == pytest.approx(dict.fromkeys(robot.joint_names, 0.0) | angles, abs=1.5)
    assert row[:7] == pytest.approx([0, 0, 0.9 * 0.72 / 0.82, 0, 0, 0, 1], abs=0.02)


def test_an_arm_that_is_caught_at_its_limits_finds_back() -> None:
    mink = pytest.importorskip('mink')
    robot = load_module(ROOT / 'examples' / 'humanoid.py').Humanoid(str(ROBOT))
    caught = dict.fromkeys(robot.joint_names, 0.0)
    caught |= {'left_shoulder_pitch_joint': 153.0, 'left_shoulder_roll_joint': -91.0}
    caught |= {'left_shoulder_yaw_joint': 114.0, 'left_elbow_joint': 107.0}
    robot.robot.update(np.r_[robot.robot.q[:7], np.radians([*caught.values()])])
    for _ in range(5):
        row = robot.follow(*stand(**BENT), mink.SE3.identity())
    assert np.degrees(row[7:]) == pytest.approx(0.0, abs=1.5)


def test_a_message_for_sonic_has_the_fields_of_the_protocol() -> None:
    sonic = load_module(ROOT / 'examples' / 'sonic.py')
    forward = turn('z', 30)
    joints, turns = stand()
    turned = (forward * Rotation.from_quat(turns)).as_quat()
    fields = sonic.convert(joints @ forward.as_matrix().T, turned) | {'frame_index': np.array([7], '<i8')}
    message = sonic.pack(fields)
    assert (len(message), message[:4]) == (2080, b'pose')
    header = json.loads(message[4:1284].rstrip(b'\0'))
    shapes = {'joint_pos': [1, 29], 'joint_vel': [1, 29], 'smpl_joints': [1, 24, 3], 'smpl_pose': [1, 21, 3]}
    expected = {name: ('f32', shape) for name, shape in (shapes | {'body_quat': [1, 4]}).items()}
    expected['frame_index'] = ('i64', [1])
    assert {f['name']: (f['dtype'], f['shape']) for f in header.pop('fields')} == expected
    assert header == {'v': 3, 'endian': 'le', 'count': 1}
    found = Rotation.from_quat(np.roll(fields['body_quat'][0], -1))
    assert found.as_rotvec() == pytest.approx(forward.as_rotvec())
    head = joints[JOINTS.index('head')] - joints[JOINTS.index('pelvis')]
    assert fields['smpl_joints'][0, 15] == pytest.approx(head)
    pose = np.zeros((21, 3))
    pose[15], pose[16] = (0, 0, -np.pi / 2), (0, 0, np.pi / 2)  # SMPL rests with its arms stretched to the sides
    assert fields['smpl_pose'][0] == pytest.approx(pose, abs=1e-6)


def test_a_result_becomes_rows_at_30_per_s_in_whose_gaps_the_robot_stays() -> None:
    pytest.importorskip('mink')
    example = load_module(ROOT / 'examples' / 'humanoid.py')
    times = np.array([0.0, 0.1, 0.4, 2.4, 2.5])
    poses = [stand(**BENT, pelvis=turn('z', 80.0 * t)) for t in times]
    result = {
        'timestamps': times,
        'joints3d': np.array([joints + [t, 0.0, 0.0] for t, (joints, _) in zip(times, poses, strict=True)]),
        'orientation': np.array([turns for _, turns in poses]),
        'world_from_camera': np.eye(4),
    }
    robot = example.Humanoid(str(ROBOT))
    rows = example.convert(robot, result)
    assert len(rows) == 76
    assert rows[12:72] == pytest.approx(np.tile(rows[12], (60, 1)))  # from 0.4 s to 2.4 s
    assert rows[75, 0] > rows[72, 0] > rows[12, 0] > rows[6, 0] > rows[0, 0]
    assert np.linalg.norm(rows[:, 3:7], axis=1) == pytest.approx(1.0)
    assert len(example.convert(robot, {k: v[:1] if len(v) == 5 else v for k, v in result.items()})) == 1


@pytest.mark.parametrize(
    ('name', 'needed'),
    [
        ('humanoid', 'mink'),
        ('sonic', 'zmq'),
        ('sonic', 'rclpy'),
        ('follow_person', 'rclpy'),
        ('people_layer', 'rclpy'),
        ('stop_when_near', 'rclpy'),
    ],
)
def test_an_example_names_what_is_not_installed(monkeypatch: pytest.MonkeyPatch, name: str, needed: str) -> None:
    for module in ('daqp', needed):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(SystemExit, match=rf'^{name}\.py: .*: (pip install|run it with) \w+'):
        runpy.run_path(str(ROOT / 'examples' / f'{name}.py'), run_name='__main__')
