# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Face, feet and hands: found from rays and lifted poses, steady, of constant size, and forgotten where unseen."""

from __future__ import annotations

import math
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.engine.extremities import sum_derivatives
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.skeleton import BODY26, CORE_COUNT, EXTREMITY_COUNT
from mocap_ros.solvers.extremities import (
    ANCHORS,
    PART_OF,
    PARTS,
    SIZE_OF,
    SIZE_STD,
    TEMPLATE,
    ExtremityEvidence,
    ExtremityState,
    attach,
    smooth_extremities,
)
from tests.support.evaluation_data import shared
from tests.support.upright_body import UPRIGHT

Array = NDArray[np.float64]

STATURE_M = 1.75
STEP_S = 1 / 30
FRAMES = 90
TIMES: Array = np.arange(FRAMES) * np.float64(STEP_S)
JOINTS = len(BODY26.joints)
# from the body's axes to the optical frame of a camera that the body faces
FACING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


class Body(NamedTuple):
    """A body over F frames: joints (F, 26, 3) m, and what tells of them."""

    joints: Array
    evidence: ExtremityEvidence


def at(name: str) -> int:
    return BODY26.index(name)


def look_around(seed: int, sizes: tuple[float, float, float] = (1.0, 1.0, 1.0), frames: int = FRAMES) -> Body:
    """Return a standing body that turns its head and its feet, seen and lifted with errors.

    Args:
        seed: seed of errors and directions.
        sizes: sizes of face, feet and hands, of that of an average person.
        frames: number of frames.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(frames) * STEP_S
    turn = Rotation.from_rotvec([0, 0, rng.uniform(-1, 1)])
    core = np.tile(turn.apply(UPRIGHT) @ FACING.T + [0.2, 0.8, 4.0], (frames, 1, 1))
    offsets = np.empty((frames, EXTREMITY_COUNT, 3))
    lifted_offsets = np.empty_like(offsets)
    for part in range(len(PARTS)):
        swing = 0.4 * np.sin(2 * np.pi * 0.4 * times[:, None] + rng.uniform(0, 6, 3)) * [0.3, 0.5, 1.0]
        local = turn * Rotation.from_rotvec(swing)
        wrong = Rotation.from_rotvec(0.1 * rng.normal(size=3) + 0.08 * rng.normal(size=(frames, 3))) * local
        for point in np.flatnonzero(part == PART_OF):
            arm = STATURE_M * sizes[SIZE_OF[part]] * TEMPLATE[point]
            offsets[:, point], lifted_offsets[:, point] = local.apply(arm) @ FACING.T, wrong.apply(arm) @ FACING.T
    joints = attach(core, offsets)
    rays = joints[..., :2] / joints[..., 2:]
    rays = rays + (0.008 * rng.normal(size=(JOINTS, 2)) + 0.005 * rng.normal(size=rays.shape)) / 4.0
    std = np.tile([0.025, 0.025, 0.04], (frames, JOINTS, 1))
    evidence = ExtremityEvidence(
        core, attach(core, lifted_offsets), std, rays, np.full((frames, JOINTS), 0.8), 0.008
    )
    return Body(joints, evidence)


def follow(evidence: ExtremityEvidence, step_s: float = STEP_S) -> list[ExtremityState]:
    states = [ExtremityState.begin(evidence.select_frame(0), STATURE_M)]
    for frame in range(1, len(evidence.core)):
        states.append(states[-1].advance(step_s, evidence.select_frame(frame), STATURE_M))
    return states


def offsets_of(states: list[ExtremityState]) -> Array:
    return np.array([s.offsets for s in states])


def hide(evidence: ExtremityEvidence, joints: list[int], frames: slice = slice(None)) -> ExtremityEvidence:
    """Return the evidence without image points and lifted positions of some joints."""
    weight, lifted = evidence.weight.copy(), evidence.lifted.copy()
    weight[frames, joints] = 0.0
    lifted[frames] = np.nan
    return evidence._replace(weight=weight, lifted=lifted)


def directions(joints: Array) -> Array:
    """Return the directions (F, 3, 3) of the head (ears to nose) and of the feet (heel to toe)."""
    ears = (joints[:, at('lear')] + joints[:, at('rear')]) / 2
    pairs = joints[:, at('nose')] - ears, joints[:, at('ltoe')] - joints[:, at('lheel')]
    return np.stack([*pairs, joints[:, at('rtoe')] - joints[:, at('rheel')]], axis=1)


def angles_deg(first: Array, second: Array) -> Array:
    """Return the angles (F, 3) in degrees between directions."""
    norms = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=-1) / norms, -1, 1)))


def tremble_deg(joints: Array) -> float:
    """Return the median angle by which the directions leave a steady turn from frame to frame."""
    d = directions(joints)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    return float(np.median(angles_deg(d[2:], 2 * d[1:-1] - d[:-2])))


def test_head_and_feet_are_truer_and_steadier_than_the_lifted_pose() -> None:
    live: list[float] = []
    smooth: list[float] = []
    lifted: list[float] = []
    tremble = []
    for seed in range(4):
        body = look_around(seed)
        core = body.evidence.core
        found = attach(core, offsets_of(follow(body.evidence)))
        whole = attach(core, smooth_extremities(TIMES, body.evidence, STATURE_M).offsets)
        for joints, errors in ((found, live), (whole, smooth), (body.evidence.lifted, lifted)):
            errors.append(float(np.median(angles_deg(directions(joints), directions(body.joints))[15:])))
        tremble.append([tremble_deg(found), tremble_deg(whole), tremble_deg(body.evidence.lifted)])
    assert np.mean(live) < 0.95 * np.mean(lifted)
    assert np.mean(smooth) < 0.95 * np.mean(live)
    assert np.mean(tremble, axis=0)[0] < 0.4 * np.mean(tremble, axis=0)[2]
    assert np.mean(tremble, axis=0)[1] < np.mean(tremble, axis=0)[0]


def test_parts_are_rigid_and_sizes_are_learnt_and_kept() -> None:
    body = look_around(5, sizes=(1.05, 1.2, 0.85), frames=400)
    states = follow(body.evidence)
    found = np.exp(states[-1].read('sizes')[:, 0])
    assert found == pytest.approx([1.05, 1.2, 0.85], rel=0.06)
    late = attach(body.evidence.core, offsets_of(states))[-60:]
    for first, second in (('lankle', 'ltoe'), ('ltoe', 'lheel'), ('nose', 'rear'), ('rwrist', 'rhand')):
        length = np.linalg.norm(late[:, at(first)] - late[:, at(second)], axis=1)
        assert np.ptp(length) < 0.01 * length.mean()
    hidden = hide(body.evidence, list(range(CORE_COUNT, JOINTS)), slice(300, None))
    assert np.exp(follow(hidden)[-1].read('sizes')[:, 0]) == pytest.approx(found, rel=0.06)


def test_unseen_parts_are_where_the_core_has_them_with_larger_deviations_and_flagged() -> None:
    body = look_around(6)
    face = [at(n) for n in ('nose', 'leye', 'reye', 'lear', 'rear')]
    hidden = hide(body.evidence, [*face, at('ltoe'), at('lheel')])
    seen, unseen = follow(body.evidence)[-1], follow(hidden)[-1]
    points = [j - CORE_COUNT for j in (*face, at('ltoe'), at('lheel'))]
    assert (unseen.offset_std[points] > 1.3 * seen.offset_std[points]).all()
    told = dict(zip(BODY26.joints, unseen.is_turn_told, strict=False))
    assert not told['head']
    assert not told['lankle']
    assert told['rankle']
    assert seen.is_turn_told[at('head')]
    nose = unseen.offsets[at('nose') - CORE_COUNT] @ FACING
    shoulders = (hidden.core[-1, at('lshoulder')] - hidden.core[-1, at('rshoulder')]) @ FACING
    assert nose @ np.cross(shoulders, [0, 0, 1]) > 0.9 * np.linalg.norm(nose[:2]) * np.linalg.norm(shoulders)


def test_the_deviations_hold_most_errors() -> None:
    within = []
    for seed in range(4):
        body = look_around(seed)
        states = follow(body.evidence)
        error = np.linalg.norm(
            offsets_of(states) - (body.joints[:, CORE_COUNT:] - body.joints[:, ANCHORS]), axis=-1
        )
        within.append((error < np.array([s.offset_std for s in states]))[15:].mean())
    assert 0.5 < np.mean(within) < 0.98


def test_states_do_not_change_and_give_the_same_again() -> None:
    evidence = look_around(7, frames=8).evidence
    states = follow(evidence)
    kept = states[3].values.copy()
    again = states[3].advance(STEP_S, evidence.select_frame(4), STATURE_M)
    assert (states[3].values == kept).all()
    assert (again.values == states[4].values).all()


def test_orientations_are_those_of_the_parts_and_do_not_jump() -> None:
    body = look_around(8)
    states = follow(body.evidence)
    quaternions = np.array([s.quaternions for s in states])
    assert (quaternions[1:] * quaternions[:-1]).sum(axis=-1).min() > 0.95
    forward = Rotation.from_quat(quaternions[-1, at('lankle')]).apply([1.0, 0.0, 0.0])
    toe = states[-1].offsets[at('ltoe') - CORE_COUNT] - states[-1].offsets[at('lheel') - CORE_COUNT]
    assert forward @ toe == pytest.approx(np.linalg.norm(toe), rel=1e-6)
    whole = smooth_extremities(TIMES, body.evidence, STATURE_M)
    assert (whole.quaternions[1:] * whole.quaternions[:-1]).sum(axis=-1).min() > 0.95


def test_a_sequence_backwards_gives_the_same() -> None:
    evidence = look_around(9).evidence
    core, lifted, std, rays, weight = (a[::-1] for a in evidence[:5])
    backwards = ExtremityEvidence(core, lifted, std, rays, weight, evidence.noise)
    one, other = (smooth_extremities(TIMES, e, STATURE_M).offsets for e in (evidence, backwards))
    far = np.linalg.norm(one - other[::-1], axis=-1)
    assert np.median(far) < 0.003  # m; the core's limbs remember their turns in one direction of time only


@settings(max_examples=30)
@given(
    numbers=arrays(float, (3, 5, JOINTS, 3), elements=st.floats(-5, 5)),
    weight=arrays(float, (5, JOINTS), elements=st.floats(0, 1)),
    step_s=st.sampled_from([1e-3, STEP_S, 0.5, 100.0]),
    is_lifted=st.booleans(),
)
def test_any_evidence_gives_finite_points_and_rotations(
    numbers: Array, weight: Array, step_s: float, is_lifted: bool
) -> None:
    lifted = numbers[1] if is_lifted else np.full_like(numbers[1], np.nan)
    std = 0.001 + np.abs(numbers[2])
    evidence = ExtremityEvidence(numbers[0, :, :CORE_COUNT], lifted, std, numbers[2, ..., :2], weight, 0.01)
    for state in follow(evidence, step_s):
        assert np.isfinite(state.values).all()
        assert np.linalg.norm(state.quaternions, axis=1) == pytest.approx(np.ones(CORE_COUNT))
        assert (state.offset_std > 0).all()
        assert (np.abs(state.read('sizes')[:, 0]) <= 5 * SIZE_STD).all()


@pytest.mark.parametrize('kind', ['lifted', 'ray'])
def test_the_gradients_are_those_of_the_sums(kind: str) -> None:
    rng = np.random.default_rng(3)
    turn, size, origin = Rotation.random(rng=rng).as_matrix(), 1.8, np.array([0.3, -0.2, 3.0])
    target, ray, sight = rng.normal(scale=0.1, size=3), np.array([0.12, -0.05]), origin / np.linalg.norm(origin)
    template, variance, robust = TEMPLATE[0], 4e-4, 2.5**2
    across, along, share = (300.0, 120.0, 0.0) if kind == 'lifted' else (0.0, 0.0, 0.7)
    depth = (origin + size * turn @ template)[2]

    def cost(x: Array) -> float:
        arm = math.exp(x[6]) * size * rotation_from_vector(x[:3]) @ turn @ template
        error, point = arm - target, origin + x[3:6] + arm
        seen = (point[:2] / point[2] - ray) * depth
        lifted = (across * error @ error + (along - across) * (sight @ error) ** 2) / 2
        return float(lifted) + share * robust / 2 * math.log1p(float(seen @ seen) / variance / robust)

    hessian, gradient = sum_derivatives(template, turn, size, origin, target, across, along, ray, variance, share)
    step = 1e-6
    numeric = [(cost(step * e) - cost(-step * e)) / (2 * step) for e in np.eye(7)]
    assert gradient == pytest.approx(numeric, rel=1e-5, abs=1e-5)
    assert (np.linalg.eigvalsh(hessian) > -1e-9).all()


@pytest.mark.parametrize('trial', ['26_01', '86_01'])
def test_recorded_heads_and_feet_are_found_in_what_a_detector_sees(trial: str, protocol: ModuleType) -> None:
    archive = np.load(shared('data/motion/body26_30fps.npz'))
    view = protocol.make_view(
        archive[trial], archive['_joints'], 60.0, frames=120, distance=3.0, detector='openpose', seed=1
    )
    names = {'lbigtoe': 'ltoe', 'rbigtoe': 'rtoe'}
    given = [names.get(str(n), str(n)) for n in view['joint_names']]
    camera, truth = view['camera_matrix'], view['joints3d'].astype(float)
    rays, weight = np.zeros((120, JOINTS, 2)), np.zeros((120, JOINTS))
    for column, name in enumerate(given):
        seen = view['keypoints'][:, column]
        is_seen = seen[:, 2] > 0.05
        rays[is_seen, at(name)] = (seen[is_seen, :2] - camera[:2, 2]) / camera[0, 0]
        weight[:, at(name)] = np.where(is_seen, seen[:, 2], 0)
    rng = np.random.default_rng(0)
    core = truth[:, :CORE_COUNT] + 0.02 * rng.normal(size=(CORE_COUNT, 3)) + 0.004 * rng.normal(size=(120, 15, 3))
    unknown = np.full((120, JOINTS, 3), np.nan)
    evidence = ExtremityEvidence(core, unknown, unknown, rays, weight, 0.015)
    found = attach(core, offsets_of(follow(evidence)))
    off = np.median(angles_deg(directions(found), directions(truth))[15:], axis=0)
    assert off[0] < 20.0  # degrees, of the head, without a lifter
    assert off[1:].mean() < 25.0  # of the feet
