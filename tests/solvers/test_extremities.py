# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Face, feet and hands from rays and lifted poses; orientations of the segments of a body."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array
from mocap_ros.engine.extremities import sum_derivatives
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.skeleton import BODY26, CORE_COUNT, EXTREMITY_COUNT
from mocap_ros.solvers import extremities
from mocap_ros.solvers.extremities import PART_OF, PARTS, SIZE_OF, TEMPLATE, ExtremityEvidence, attach
from tests.support.bodies import UPRIGHT, angles_deg

STATURE_M = 1.75
STEP_S = 1 / 30
FRAMES = 90
TIMES: Array = np.arange(FRAMES) * np.float64(STEP_S)
JOINTS = len(BODY26.joints)
# from the body's axes to the optical frame of a camera that the body faces
FACING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def at(name: str) -> int:
    return BODY26.index(name)


def look_around(
    seed: int, sizes: tuple[float, float, float] = (1.0, 1.0, 1.0), frames: int = FRAMES
) -> tuple[Array, ExtremityEvidence]:
    """Joints (F, 26, 3) m of a standing body that turns its head and its feet, and what is seen of them.

    The sizes of face, feet and hands are in average ones.
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
    weight, noise = np.full((frames, JOINTS), 0.8), np.full(frames, 0.008)
    return joints, ExtremityEvidence(core, attach(core, lifted_offsets), std, rays, weight, noise)


def follow(evidence: ExtremityEvidence, step_s: float = STEP_S, *, is_steady: bool = False) -> NDArray[Any]:
    state, states = extremities.START[None].copy(), []
    for frame in range(len(evidence.core)):
        seen = ExtremityEvidence(*(np.ascontiguousarray(values[frame : frame + 1]) for values in evidence))
        extremities.BODY.follow(state, seen, np.array([STATURE_M]), np.array([frame * step_s]), is_steady)
        states.append(state.copy())
    return extremities.read_states(np.concatenate(states))


def hide(evidence: ExtremityEvidence, joints: list[int], frames: slice = slice(None)) -> ExtremityEvidence:
    weight, lifted = evidence.weight.copy(), evidence.lifted.copy()
    weight[frames, joints] = 0.0
    lifted[frames] = np.nan
    return evidence._replace(weight=weight, lifted=lifted)


def directions(joints: Array) -> Array:
    """Return the directions (F, 3, 3) of the head (ears to nose) and of the feet (heel to toe)."""
    ears = (joints[:, at('lear')] + joints[:, at('rear')]) / 2
    pairs = joints[:, at('nose')] - ears, joints[:, at('ltoe')] - joints[:, at('lheel')]
    return np.stack([*pairs, joints[:, at('rtoe')] - joints[:, at('rheel')]], axis=1)


def jitter_deg(joints: Array) -> float:
    """Return the median angle by which the directions leave a steady turn from frame to frame."""
    d = directions(joints)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    return float(np.median(angles_deg(d[2:], 2 * d[1:-1] - d[:-2])))


def test_head_and_feet_are_truer_and_steadier_than_the_lifted_pose() -> None:
    off: list[list[float]] = []
    jitter: list[list[float]] = []
    within, last = [], []
    for seed in range(4):
        truth, evidence = look_around(seed)
        states = follow(evidence)
        smooth = attach(evidence.core, extremities.smooth_extremities(TIMES, evidence, STATURE_M).offsets)
        found = (evidence.lifted, attach(evidence.core, states['offsets']), smooth)
        off.append([float(np.median(angles_deg(directions(j), directions(truth))[15:])) for j in found])
        jitter.append([jitter_deg(joints) for joints in found])
        error = np.linalg.norm(found[1][:, CORE_COUNT:] - truth[:, CORE_COUNT:], axis=-1)
        within.append((error < states['offset_std'])[15:].mean())
        steps = np.linalg.norm(np.diff(directions(smooth)[-10:], axis=0), axis=-1)
        last.append(steps[-1] / steps[:-1].mean(axis=0))
    assert np.mean(last) < 1.3, 'the last frame is as steady as those before'
    lifted, live, whole = np.mean(off, axis=0)
    assert whole < 0.95 * live < 0.95**2 * lifted
    lifted, live, whole = np.mean(jitter, axis=0)
    assert whole < live < 0.4 * lifted
    assert 0.5 < np.mean(within) < 0.98, 'the deviations hold most errors'


def test_a_long_sequence_in_blocks_is_as_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    _, evidence = look_around(0)
    whole = extremities.smooth_extremities(TIMES, evidence, STATURE_M)
    monkeypatch.setattr(extremities, 'BLOCK_FRAMES', len(TIMES) // 3)
    in_blocks = extremities.smooth_extremities(TIMES, evidence, STATURE_M)
    for values, expected in zip(in_blocks, whole, strict=True):
        assert values.astype(float) == pytest.approx(expected.astype(float), abs=1e-9)


def test_parts_are_rigid_and_sizes_are_learnt_and_kept() -> None:
    _, evidence = look_around(5, sizes=(1.05, 1.2, 0.85), frames=400)
    states = follow(evidence)
    found = np.exp(states[-1]['sizes'][:, 0])
    assert found == pytest.approx([1.05, 1.2, 0.85], rel=0.06)
    late = attach(evidence.core, states['offsets'])[-60:]
    for first, second in (('lankle', 'ltoe'), ('ltoe', 'lheel'), ('nose', 'rear'), ('rwrist', 'rhand')):
        length = np.linalg.norm(late[:, at(first)] - late[:, at(second)], axis=1)
        assert np.ptp(length) < 0.01 * length.mean()
    hidden = hide(evidence, list(range(CORE_COUNT, JOINTS)), slice(300, None))
    assert np.exp(follow(hidden)[-1]['sizes'][:, 0]) == pytest.approx(found, rel=0.06)


def test_unseen_parts_are_where_the_core_has_them_with_larger_deviations_and_flagged() -> None:
    _, evidence = look_around(6)
    face = [at(n) for n in ('nose', 'leye', 'reye', 'lear', 'rear')]
    hidden = hide(evidence, [*face, at('ltoe'), at('lheel')])
    seen, unseen = follow(evidence)[-1], follow(hidden)[-1]
    points = [j - CORE_COUNT for j in (*face, at('ltoe'), at('lheel'))]
    assert (unseen['offset_std'][points] > 1.3 * seen['offset_std'][points]).all()
    is_seen = dict(zip(BODY26.joints, unseen['is_turn_seen'], strict=False))
    assert [is_seen[name] for name in ('head', 'lankle', 'rankle')] == [False, False, True]
    assert seen['is_turn_seen'][at('head')]
    nose = unseen['offsets'][at('nose') - CORE_COUNT] @ FACING
    shoulders = (hidden.core[-1, at('lshoulder')] - hidden.core[-1, at('rshoulder')]) @ FACING
    assert nose @ np.cross(shoulders, [0, 0, 1]) > 0.9 * np.linalg.norm(nose[:2]) * np.linalg.norm(shoulders)


@settings(max_examples=20)
@given(
    numbers=arrays(float, (3, 5, JOINTS, 3), elements=st.floats(-5, 5)),
    weight=arrays(float, (5, JOINTS), elements=st.floats(0, 1)),
    step_s=st.sampled_from([1e-3, STEP_S, 0.5, 100.0]),
    is_lifted=st.booleans(),
)
def test_any_evidence_gives_finite_results(numbers: Array, weight: Array, step_s: float, is_lifted: bool) -> None:
    lifted = numbers[1] if is_lifted else np.full_like(numbers[1], np.nan)
    core, std, rays = numbers[0, :, :CORE_COUNT], 0.001 + np.abs(numbers[2]), numbers[2, ..., :2]
    evidence = ExtremityEvidence(core, lifted, std, rays, weight, np.full(5, 0.01))
    for state in follow(evidence, step_s):
        assert all(np.isfinite(state[name]).all() for name in state.dtype.names)
        assert np.linalg.norm(state['quaternions'], axis=1) == pytest.approx(np.ones(CORE_COUNT))
        segments = state['segments'].reshape(-1, CORE_COUNT, 3, 3)
        square = segments @ np.swapaxes(segments, -1, -2)
        assert square == pytest.approx(np.broadcast_to(np.eye(3), square.shape), abs=1e-6)
        assert (np.linalg.det(segments) > 0).all()
        assert (state['offset_std'] > 0).all()
        assert (np.abs(state['sizes'][:, 0]) <= 5 * extremities.SIZE_STD).all()


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


def find_segments(poses: Array) -> Array:
    """Return the segments (F, 15, 3, 3) as the core (F, 15, 3) alone has them."""
    return np.asarray(follow(ExtremityEvidence.without_image(poses))['segments']).reshape(-1, CORE_COUNT, 3, 3)


@pytest.mark.parametrize('seed', range(5))
def test_all_segments_of_an_upright_body_have_its_axes(seed: int) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    (segments,) = find_segments((UPRIGHT @ turn.T)[None])
    hanging = [i for i in range(CORE_COUNT) if i not in extremities.PART_SEGMENTS]
    assert segments[hanging] == pytest.approx(np.tile(turn, (len(hanging), 1, 1)), abs=1e-9)
    assert segments[at('head')] == pytest.approx(turn @ extremities.HEAD_REST, abs=1e-9)
    assert segments[at('lankle')] == pytest.approx(turn @ extremities.FOOT_REST, abs=1e-9)
    assert segments[at('rwrist')] == pytest.approx(turn @ extremities.HAND_REST[1], abs=1e-9)


@pytest.mark.parametrize(('upper', 'bent', 'sign'), [('lshoulder', 'lelbow', -1), ('rhip', 'rknee', 1)])
def test_a_bent_limb_shows_how_it_is_turned_about_itself(upper: str, bent: str, sign: int) -> None:
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
        forearm = UPRIGHT[at('lwrist')] - UPRIGHT[at('lelbow')]
        pose[at('lwrist')] = pose[at('lelbow')] + (spin * bend).apply(forearm)
    arm = Rotation.from_matrix(find_segments(poses)[:, at('lshoulder')])
    steps = np.degrees((arm[1:] * arm[:-1].inv()).magnitude())
    assert steps.max() < 8.0  # without memory it would turn by 60 degrees at once
    assert np.degrees((arm[24] * spin.inv()).magnitude()) < 30.0


@pytest.mark.parametrize('seed', range(3))
def test_quaternions_are_those_of_the_segments_and_do_not_jump(seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    poses = np.array([Rotation.from_rotvec(0.2 * frame * axis).apply(UPRIGHT) for frame in range(60)])
    states = follow(ExtremityEvidence.without_image(poses))
    core = [at(name) for name in ('pelvis', 'neck', 'lshoulder', 'relbow')]
    quaternions = states['quaternions'][:, core]
    segments = states['segments'][:, core]
    found = Rotation.from_quat(quaternions.reshape(-1, 4)).as_matrix()
    assert found == pytest.approx(segments.reshape(-1, 3, 3), abs=1e-9)
    assert (np.abs(np.diff(quaternions, axis=0)) < 0.9).all()


def test_steady_orientations_lose_jitter_and_single_wrong_frames_but_not_a_turn() -> None:
    step_s, rng = 1 / 60, np.random.default_rng(0)
    turns = Rotation.from_rotvec(np.arange(120)[:, None] * step_s * [0.0, 0.0, 1.5])  # at 1.5 rad/s
    poses = np.array([turn.apply(UPRIGHT) for turn in turns])
    poses += 0.003 * rng.normal(size=poses.shape)
    poses[90] = turns[90].apply(UPRIGHT * [-1.0, -1.0, 1.0])  # back to front
    jitters = []
    for is_steady in (False, True):
        states = follow(ExtremityEvidence.without_image(poses), step_s, is_steady=is_steady)
        found = Rotation.from_quat(states['quaternions'][:, at('neck')])
        spins = (found[1:] * found[:-1].inv()).as_rotvec() / step_s
        jitters.append(np.linalg.norm(np.diff(spins[30:88], axis=0), axis=1).mean() / step_s)
        errors = np.degrees((found * turns.inv()).magnitude())
    assert jitters[1] < jitters[0] / 3
    assert errors[30:90].mean() < 1.0
    assert errors[90:].max() < 25.0
