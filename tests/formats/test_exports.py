# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint angles are found again, with their signs, through singular poses and whole turns; armatures of BVH."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, UPRIGHT_DEG, compute_joint_angles
from mocap_ros.skeleton import CMU15

# m; where the joints are in the axes of their segments, of a person who stands upright with hanging arms
STANDING: dict[str, tuple[float, float, float]] = {
    'pelvis': (0, 0, 0), 'lhip': (0.04, -0.1, -0.1), 'rhip': (0.04, -0.1, 0.1),
    'neck': (0, 0.5, 0), 'lshoulder': (0.01, 0.45, -0.18), 'rshoulder': (0.01, 0.45, 0.18), 'head': (0, 0.2, 0),
    'lknee': (0, -0.44, 0), 'rknee': (0, -0.44, 0), 'lankle': (0, -0.42, 0), 'rankle': (0, -0.42, 0),
    'lelbow': (0, -0.3, 0), 'relbow': (0, -0.3, 0), 'lwrist': (0, -0.26, 0), 'rwrist': (0, -0.26, 0),
}  # fmt: skip


def compute_joints(values: np.ndarray, places: dict[str, Any]) -> np.ndarray:
    """Return the joints (F, 15, 3) in m of coordinates (F, C), written out from the formulas of `joint_angles`."""
    q = dict(zip(COORDINATES, values.T, strict=True))

    def turn(axis: str, name: str, sign: float = 1.0) -> Rotation:
        return Rotation.from_euler(axis, sign * q[name][:, None], degrees=True)

    at = {'pelvis': np.column_stack([q['pelvis_tx'], q['pelvis_ty'], q['pelvis_tz']])}

    def place(joint: str, segment: Rotation, origin: str) -> None:
        at[joint] = at[origin] + segment.apply(np.asarray(places[joint], float))

    pelvis = turn('y', 'pelvis_rotation') * turn('x', 'pelvis_list') * turn('z', 'pelvis_tilt')
    torso = pelvis * turn('z', 'lumbar_extension') * turn('x', 'lumbar_bending') * turn('y', 'lumbar_rotation')
    for joint in ('lhip', 'rhip'):
        place(joint, pelvis, 'pelvis')
    for joint in ('neck', 'lshoulder', 'rshoulder'):
        place(joint, torso, 'pelvis')
    place('head', torso * turn('z', 'neck_extension') * turn('x', 'neck_bending'), 'neck')
    for side, sign in (('r', 1.0), ('l', -1.0)):
        thigh = pelvis * turn('z', f'hip_flexion_{side}') * turn('x', f'hip_adduction_{side}', sign)
        thigh = thigh * turn('y', f'hip_rotation_{side}', sign)
        place(f'{side}knee', thigh, f'{side}hip')
        place(f'{side}ankle', thigh * turn('z', f'knee_angle_{side}', -1.0), f'{side}knee')
        arm = torso * turn('z', f'arm_flex_{side}') * turn('x', f'arm_add_{side}', sign)
        arm = arm * turn('y', f'arm_rot_{side}', sign)
        place(f'{side}elbow', arm, f'{side}shoulder')
        place(f'{side}wrist', arm * turn('z', f'elbow_flex_{side}'), f'{side}elbow')
    return np.stack([at[joint] for joint in CMU15.joints], axis=1)


FPS = 30.0
# m; the hips of `STANDING` lie below the pelvis at the angle by which joint angles take a pelvis as upright
HIP_DROP = np.hypot(*STANDING['rhip'][:2])
PLACES = {
    **STANDING,
    'rhip': (HIP_DROP * np.sin(np.radians(UPRIGHT_DEG)), -HIP_DROP * np.cos(np.radians(UPRIGHT_DEG)), 0.1),
    'lhip': (HIP_DROP * np.sin(np.radians(UPRIGHT_DEG)), -HIP_DROP * np.cos(np.radians(UPRIGHT_DEG)), -0.1),
    'lshoulder': (0.0, 0.45, -0.18),
    'rshoulder': (0.0, 0.45, 0.18),
}
ANGLES = [name for name in COORDINATES if name not in POSITIONS]
# degrees; beyond these, the angles of other coordinates mean little
LIMITS = {'pelvis_list': (-70, 70), 'lumbar_bending': (-60, 60), 'neck_bending': (-60, 60)}
LIMITS |= {f'{name}_{side}': (20, 150) for side in 'rl' for name in ('knee_angle', 'elbow_flex')}
LIMITS |= {f'{name}_{side}': (-60, 60) for side in 'rl' for name in ('hip_adduction', 'arm_add')}


def build_values(frames: int = 1, /, **values: Any) -> np.ndarray:
    """Return coordinates (F, C) that are 0 but for these; knees and elbows are bent by 30 degrees."""
    bent = {f'{name}_{side}': 30.0 for side in 'rl' for name in ('knee_angle', 'elbow_flex')}
    columns = {**dict.fromkeys(COORDINATES, 0.0), **bent, **values}
    return np.column_stack([np.broadcast_to(np.asarray(columns[name], float), frames) for name in COORDINATES])


def measure(values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the angles (F,) found in the poses of coordinates (F, C)."""
    found = compute_joint_angles(compute_joints(values, PLACES), FPS)
    return dict(zip(COORDINATES, found.T, strict=True))


@settings(max_examples=60)
@given(st.data())
def test_the_angles_of_a_pose_are_found_again(data: st.DataObject) -> None:
    values = {name: data.draw(st.floats(*LIMITS.get(name, (-80, 80)))) for name in ANGLES}
    values |= {name: data.draw(st.floats(-5, 5)) for name in POSITIONS}
    found = measure(build_values(**values))
    for name, value in values.items():
        assert found[name][0] == pytest.approx(value, abs=1e-3), name


@pytest.mark.parametrize(
    ('joint', 'axis', 'name', 'sign'),
    [  # in which direction a joint moves, of a person who faces along x, if an angle grows
        ('rknee', 0, 'hip_flexion_r', 1), ('lknee', 0, 'hip_flexion_l', 1),
        ('rknee', 2, 'hip_adduction_r', -1), ('lknee', 2, 'hip_adduction_l', 1),
        ('rankle', 0, 'knee_angle_r', -1), ('lankle', 0, 'knee_angle_l', -1),
        ('relbow', 0, 'arm_flex_r', 1), ('lelbow', 2, 'arm_add_l', 1), ('relbow', 2, 'arm_add_r', -1),
        ('rwrist', 0, 'elbow_flex_r', 1), ('neck', 0, 'lumbar_extension', -1), ('neck', 2, 'lumbar_bending', 1),
        ('head', 0, 'neck_extension', -1), ('neck', 0, 'pelvis_tilt', -1), ('rhip', 1, 'pelvis_list', -1),
        ('rhip', 0, 'pelvis_rotation', 1), ('rshoulder', 0, 'lumbar_rotation', 1),
        ('rankle', 2, 'hip_rotation_r', 1), ('lankle', 2, 'hip_rotation_l', -1),
    ],
)  # fmt: skip
def test_the_signs_are_those_of_the_documents(joint: str, axis: int, name: str, sign: int) -> None:
    index = CMU15.joints.index(joint)
    before = compute_joints(build_values(), PLACES)[0, index, axis]
    bent = build_values()[0, COORDINATES.index(name)] + 20.0
    moved = compute_joints(build_values(**{name: bent}), PLACES)
    assert np.sign(moved[0, index, axis] - before) == sign
    assert compute_joint_angles(moved, FPS)[0, COORDINATES.index(name)] == pytest.approx(bent, abs=1e-3)


def test_whole_turns_are_counted() -> None:
    turns = np.linspace(-30.0, 750.0, 120)
    found = measure(build_values(120, pelvis_rotation=turns))
    assert found['pelvis_rotation'] - found['pelvis_rotation'][0] == pytest.approx(turns + 30.0, abs=1e-3)
    found = measure(build_values(120, arm_flex_r=turns))  # arms that circle
    assert found['arm_flex_r'] - found['arm_flex_r'][0] == pytest.approx(turns + 30.0, abs=1e-3)


def test_an_arm_is_raised_sideways_above_the_head_without_a_jump() -> None:
    raised = np.linspace(0.0, -170.0, 61)
    found = measure(build_values(61, arm_add_r=raised, arm_add_l=raised, arm_rot_r=10.0))
    for side in 'rl':
        assert found[f'arm_add_{side}'] == pytest.approx(raised, abs=1.0)
        assert found[f'arm_flex_{side}'] == pytest.approx(np.zeros(61), abs=3.0)
    assert found['arm_rot_r'] == pytest.approx(np.full(61, 10.0), abs=3.0)


def test_the_turn_of_a_straight_leg_is_interpolated() -> None:
    bend = np.r_[np.full(20, 40.0), np.full(10, 2.0), np.full(20, 40.0)]
    turn = np.r_[np.full(20, 0.0), np.full(10, 90.0), np.full(20, 20.0)]  # what noise makes of a straight leg
    found = measure(build_values(50, knee_angle_r=bend, hip_rotation_r=turn))
    assert found['hip_rotation_r'][[0, 18, 31, 49]] == pytest.approx([0.0, 0.0, 20.0, 20.0], abs=1.0)
    assert (np.diff(found['hip_rotation_r']) >= -1e-6).all()
    assert found['hip_rotation_r'][25] == pytest.approx(10.0, abs=6.0)


@pytest.mark.parametrize(('first', 'last'), [(40.0, 40.0), (-4.0, 40.0), (-4.0, -4.0)])
def test_a_knee_that_is_overstretched_turns_no_leg(first: float, last: float) -> None:
    bend = np.r_[np.full(30, first), np.full(60, -4.0), np.full(30, last)]
    found = measure(build_values(120, knee_angle_r=bend, hip_rotation_r=10.0, hip_flexion_r=100.0))
    for name, expected in (('knee_angle_r', bend), ('hip_rotation_r', 10.0), ('hip_flexion_r', 100.0)):
        assert found[name] == pytest.approx(np.broadcast_to(expected, 120), abs=0.5)


@pytest.mark.filterwarnings('error')
def test_degenerate_bodies_give_finite_angles_and_bones() -> None:
    point = np.zeros((3, 15, 3))
    line = np.repeat(np.linspace([0, 0, 0], [0, 2, 0], 15)[None], 3, axis=0)
    across = line[..., [1, 0, 2]]
    for joints in (point, line, across, line[:1]):
        assert np.isfinite(compute_joint_angles(joints, FPS)).all()
        bvh = build_armature(joints, FPS)
        assert np.isfinite(bvh.motion).all()
        assert (np.linalg.norm(bvh.offsets[1:], axis=1) > 0.99).all()
