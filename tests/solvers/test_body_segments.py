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

from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.solvers.body_segments import FOOT_REST, HAND_REST, HEAD_REST, PART_SEGMENTS, SEGMENT_COUNT
from mocap_ros.solvers.extremities import TEMPLATE, ExtremityEvidence, ExtremityState, attach
from tests.support.upright_body import UPRIGHT

Array = NDArray[np.float64]

STEP_S = 1 / 30
# from the body's axes to the optical frame of a camera that the body faces
FACING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def follow(poses: Array) -> list[ExtremityState]:
    """Return the states of a body of which the core (F, 15, 3) alone is known."""
    evidence = [ExtremityEvidence.without_image(pose) for pose in poses]
    states = [ExtremityState.begin(evidence[0], 1.75)]
    for known in evidence[1:]:
        states.append(states[-1].advance(STEP_S, known, 1.75))
    return states


def find_segments(poses: Array) -> Array:
    """Return the segments (F, 15, 3, 3) as the core has them."""
    return np.array([state.read('segments') for state in follow(poses)])


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
    upright = UPRIGHT @ FACING.T + [0.0, 0.8, 4.0]
    out_turned = Rotation.from_rotvec([0, 0, math.radians(20)]).as_matrix()
    joints = attach(upright, 1.75 * TEMPLATE @ (FACING @ out_turned).T)
    weight = np.ones(len(BODY26.joints))
    weight[[BODY26.index(n) for n in ('lshoulder', 'ltoe', 'lheel', 'lhand', 'rhand')]] = 0
    unknown = np.full(joints.shape, np.nan)
    evidence = ExtremityEvidence(upright, unknown, unknown, joints[:, :2] / joints[:, 2:], weight, 0.003)
    state = ExtremityState.begin(evidence, 1.75)
    for _ in range(60):
        state = state.advance(STEP_S, evidence, 1.75)
    turns = FACING.T @ Rotation.from_quat(state.quaternions).as_matrix()
    heading = np.degrees(Rotation.from_matrix(turns).as_rotvec())[:, 2]
    assert 5 < heading[at('rknee')] < heading[at('rankle')]  # between the pelvis and the foot
    assert abs(heading[at('lknee')]) < 5
    names = {name for name, is_told in zip(CMU15.joints, state.is_turn_told, strict=True) if is_told}
    assert names == {'head', 'pelvis', 'rankle', 'rknee', 'rhip'}


@given(st.integers(0, 2**32 - 1))
def test_quaternions_of_a_motion_do_not_jump(seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    poses = [Rotation.from_rotvec(0.2 * frame * axis).apply(UPRIGHT) for frame in range(60)]
    states = follow(np.array(poses))
    quaternions = np.array([state.quaternions for state in states])
    segments = np.array([state.read('segments') for state in states])
    core = [at(name) for name in ('pelvis', 'neck', 'lshoulder', 'relbow')]
    found = Rotation.from_quat(quaternions[:, core].reshape(-1, 4)).as_matrix()
    assert found == pytest.approx(segments[:, core].reshape(-1, 3, 3), abs=1e-9)
    assert (quaternions[0, :, 3] >= 0).all()
    assert (np.abs(np.diff(quaternions[:, core], axis=0)) < 0.9).all()
