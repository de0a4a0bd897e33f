# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Orientations of the segments of a body: standing upright in any direction, bent limbs, quaternions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.body_segments import (
    FOOT_REST,
    HAND_REST,
    HEAD_REST,
    PART_SEGMENTS,
    SEGMENT_COUNT,
    write_core_segments,
    write_orientations,
    write_quaternions,
)
from tests.support.upright_body import UPRIGHT

Array = NDArray[np.float64]

STEP_S = 1 / 30


@pytest.fixture(scope='module', autouse=True)
def compiled() -> None:
    compile_kernels()


def follow(poses: Array) -> tuple[Array, Array]:
    """Return the segments (F, 15, 3, 3) and the turns of the limbs (F, 4, 3) of poses (F, 15, 3)."""
    segments, twist = np.tile(np.eye(3), (SEGMENT_COUNT, 1, 1)), np.zeros((4, 3))
    found = []
    for frame, pose in enumerate(poses):
        write_core_segments(segments, twist, np.ascontiguousarray(pose), STEP_S if frame else math.inf)
        found.append((segments.copy(), twist.copy()))
    return tuple(map(np.array, zip(*found, strict=True)))  # type: ignore[return-value]


def find_segments(poses: Array) -> Array:
    return follow(poses)[0]


def at(name: str) -> int:
    return CMU15.index(name)


@given(st.integers(0, 2**32 - 1))
def test_all_segments_of_somebody_who_stands_upright_have_the_axes_of_the_body(seed: int) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    (segments,) = find_segments((UPRIGHT @ turn.T)[None])
    hanging = [i for i in range(SEGMENT_COUNT) if i not in PART_SEGMENTS]
    assert segments[hanging] == pytest.approx(np.tile(turn, (len(hanging), 1, 1)), abs=1e-9)
    assert segments[at('head')] == pytest.approx(turn @ HEAD_REST, abs=1e-9)
    assert segments[at('lankle')] == pytest.approx(turn @ FOOT_REST, abs=1e-9)
    assert segments[at('rwrist')] == pytest.approx(turn @ HAND_REST[1], abs=1e-9)


@pytest.mark.parametrize(('upper', 'bent', 'sign'), [('lshoulder', 'lelbow', -1), ('rhip', 'rknee', 1)])
def test_a_bent_limb_tells_how_it_is_turned_about_itself(upper: str, bent: str, sign: int) -> None:
    middle, lower = at(bent), at(bent) + 1
    bend = Rotation.from_rotvec([0, sign * math.radians(70), 0])  # about y: forearms forwards, shanks backwards
    spin = Rotation.from_rotvec([0, 0, math.radians(40)])  # of the whole limb about its own axis
    pose = UPRIGHT.copy()
    pose[lower] = pose[middle] + spin.apply(bend.apply(UPRIGHT[lower] - UPRIGHT[middle]))
    (segments,) = find_segments(pose[None])
    off = (Rotation.from_matrix(segments[at(upper)]).inv() * spin).magnitude()
    assert math.degrees(off) < 40 * 0.2  # the direction of rest still counts a little
    relative = Rotation.from_matrix(segments[at(upper)].T @ segments[middle]).as_rotvec(degrees=True)
    assert relative == pytest.approx([0, sign * 70, 0], abs=5.0)  # both bones have one y, but for the rest


def test_an_arm_that_is_straight_for_a_moment_keeps_its_turn() -> None:
    spin = Rotation.from_rotvec([0, 0, math.radians(60)])
    poses = np.tile(UPRIGHT, (40, 1, 1))
    angles = np.radians(np.r_[np.full(20, 80.0), np.zeros(5), np.full(15, 80.0)])
    for pose, angle in zip(poses, angles, strict=True):
        bend = Rotation.from_rotvec([0, -angle, 0])
        pose[at('lwrist')] = pose[at('lelbow')] + spin.apply(
            bend.apply(UPRIGHT[at('lwrist')] - UPRIGHT[at('lelbow')])
        )
    arm = Rotation.from_matrix(find_segments(poses)[:, at('lshoulder')])
    steps = np.degrees((arm[1:] * arm[:-1].inv()).magnitude())
    assert steps.max() < 8.0  # without memory it would turn by 60 degrees at once
    assert np.degrees((arm[24] * spin.inv()).magnitude()) < 30.0


@given(arrays(float, (3, 15, 3), elements=st.floats(-3, 3)))
def test_any_pose_gives_rotations(poses: Array) -> None:
    segments = find_segments(poses)
    products = segments @ np.swapaxes(segments, -1, -2)
    assert products == pytest.approx(np.broadcast_to(np.eye(3), products.shape), abs=1e-6)
    assert np.linalg.det(segments) == pytest.approx(np.ones(segments.shape[:2]), abs=1e-6)


def test_feet_turn_straight_legs_and_unseen_limbs_are_flagged() -> None:
    segments, twist = (a[0] for a in follow(UPRIGHT[None]))
    out_turned = Rotation.from_rotvec([0, 0, math.radians(30)]).as_matrix()
    parts = np.tile(out_turned, (5, 1, 1))
    out, told = np.empty_like(segments), np.empty(SEGMENT_COUNT, bool)
    is_part_told, seen = np.array([True, True, False, False, False]), np.ones(SEGMENT_COUNT, bool)
    seen[at('lshoulder')] = False
    write_orientations(out, told, segments, twist, parts, is_part_told, seen)
    heading = Rotation.from_matrix(out[at('lknee')]).as_rotvec(degrees=True)
    assert heading == pytest.approx([0, 0, heading[2]], abs=1e-9)
    assert 15 < heading[2] < 30  # between the pelvis and the foot
    assert out[at('head')] == pytest.approx(out_turned)
    names = {name for name, is_told in zip(CMU15.joints, told, strict=True) if is_told}
    assert names == {'head', 'pelvis', 'lankle', 'lknee', 'lhip'}


@given(st.integers(0, 2**32 - 1))
def test_quaternions_of_a_motion_do_not_jump(seed: int) -> None:
    axes = np.random.default_rng(seed).normal(size=(4, 3))
    turns = [Rotation.from_rotvec(0.3 * frame * axes) for frame in range(60)]
    quaternions, before = np.zeros((4, 4)), None
    for turn in turns:
        write_quaternions(quaternions, turn.as_matrix())
        assert Rotation.from_quat(quaternions).as_matrix() == pytest.approx(turn.as_matrix(), abs=1e-9)
        assert before is None or (np.abs(quaternions - before) < 0.9).all()
        assert before is not None or (quaternions[:, 3] >= 0).all()
        before = quaternions.copy()
