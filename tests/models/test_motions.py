# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a pose shows, and the networks of its motion: what they must not depend on, and where they do nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.engine.motion import describe_cores
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.models.model_file import load_base_poses, load_motion_predictor, load_velocity_correction
from mocap_ros.models.motion_predictor import PAST_S, Displacements, Past
from mocap_ros.models.upward_direction import MASSES, SUPPORT_AHEAD, Stances
from mocap_ros.models.velocity_correction import LEAST_PAST_S, MAX_CORRECTION, SPANS_S, VelocityPast
from mocap_ros.people import HIPS
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.extremities import ExtremityEvidence
from tests.support.bodies import STANDING

UP = np.array([0.0, 0.0, 1.0])
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # turns y down into z up
FORWARD = np.array([0.0, -1.0, 0.0])  # where the body then faces
TIMES = np.array([0.2, 0.4, 0.6, 1.0])


def make_past(speed: float = 0.0, std: float = 0.02, place: tuple[float, float, float] = (3.0, 1.0, 0.0)) -> Past:
    """Return one upright person in a frame with z up who moves ahead at a speed in m/s, limbs at rest."""
    joints = STANDING @ UPRIGHT.T + place
    velocity = np.tile(speed * FORWARD, (15, 1))
    earlier = joints - np.array(PAST_S)[:, None, None] * velocity
    past = joints, velocity, np.full(15, std), earlier, FORWARD, UP
    return Past(*(values[None] for values in past))


def predict_one(past: Past, times: np.ndarray) -> Displacements:
    return Displacements(*(values[0] for values in load_motion_predictor().predict(past, times[None])))


def test_who_stands_stays_and_who_walks_goes_on() -> None:
    standing, walking = (predict_one(make_past(speed), TIMES).joints for speed in (0.0, 1.3))
    assert np.linalg.norm(standing, axis=2).max() < 0.2
    np.testing.assert_allclose((walking - standing).mean(axis=1) @ FORWARD, 1.3 * TIMES, rtol=0.5)


@given(st.integers(0, 2**31), st.floats(0.0, 3.0))
@settings(max_examples=30)
def test_a_prediction_turns_with_the_axes_of_the_camera(seed: int, speed: float) -> None:
    turn = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    past = make_past(speed)
    turned = Past(*(value if i == 2 else value @ turn.T for i, value in enumerate(past)))
    one, other = (predict_one(p, TIMES) for p in (past, turned))
    np.testing.assert_allclose(one.joints @ turn.T, other.joints, atol=1e-9)
    np.testing.assert_allclose(turn @ one.root_covariance @ turn.T, other.root_covariance, atol=1e-9)
    np.testing.assert_allclose(one.std, other.std, atol=1e-12)


def test_between_its_times_a_prediction_is_continuous_and_begins_with_the_newest_frame() -> None:
    past = make_past(1.3)
    at_zero = predict_one(past, np.zeros(1))
    np.testing.assert_allclose(at_zero.joints, 0, atol=1e-12)
    np.testing.assert_allclose(at_zero.std, past.std)
    np.testing.assert_allclose(at_zero.root_covariance, 0)
    dense = predict_one(past, np.linspace(0, 1, 101))
    assert np.abs(np.diff(dense.joints, axis=0)).max() < 0.05, 'less than 5 m/s'
    deviations = np.trace(dense.root_covariance, axis1=1, axis2=2)
    assert (np.diff(deviations) > 0).all()
    assert (np.diff(dense.std, axis=0) >= 0).all()
    last, beyond = (predict_one(past, np.array([t])) for t in (1.0, 1.5))
    np.testing.assert_allclose(beyond.joints, last.joints)
    np.testing.assert_allclose(beyond.root_covariance, 2.25 * last.root_covariance)


def test_people_are_predicted_together_as_alone() -> None:
    pasts = [make_past(0.0), make_past(1.3, 0.05, (4.0, -2.0, 0.1)), make_past(0.7, np.nan)]
    times = np.array([TIMES, TIMES + 0.05, TIMES / 3])
    together = load_motion_predictor().predict(Past(*map(np.concatenate, zip(*pasts, strict=True))), times)
    for n, past in enumerate(pasts):
        alone = predict_one(past, times[n])
        for ours, own in zip(together, alone, strict=True):
            np.testing.assert_allclose(ours[n], own, atol=1e-12)


SPANS = np.array(SPANS_S)


def make_velocity_past(seed: int, jitter_m: float = 0.02) -> VelocityPast:
    """Return an upright person in an optical frame, 4 m away, whose earlier positions have this jitter."""
    rng = np.random.default_rng(seed)
    joints = STANDING + [0.5, 0.0, 4.0]
    velocity = rng.normal(0, 1, 3) + rng.normal(0, 0.3, (15, 3))
    earlier = joints - SPANS[:, None, None] * velocity + rng.normal(0, jitter_m, (len(SPANS), 15, 3))
    axes = Rotation.random(random_state=rng).as_matrix()
    past = velocity, rng.uniform(0.1, 0.8, 15), joints, earlier, axes
    return VelocityPast(*(values[None] for values in past))


def find_correction(past: VelocityPast) -> np.ndarray:
    """Return what the network adds to velocities; deviations and covariances follow by the formulas."""
    velocity, std = past.velocity.copy(), past.std.copy()
    covariance, before = np.diag([0.1, 0.2, 0.3])[None].repeat(len(velocity), 0), np.diag([0.1, 0.2, 0.3])
    load_velocity_correction().correct(past._replace(velocity=velocity, std=std), covariance)
    added = velocity - past.velocity
    if added.any():
        expected = np.hypot(0.7 * past.std, 0.7 * np.linalg.norm(added, axis=-1))
        np.testing.assert_allclose(std, expected, rtol=1e-9)
        root = 0.7 * (added[0, HIPS[0]] + added[0, HIPS[1]]) / 2
        np.testing.assert_allclose(covariance[0], 1.69 * (0.49 * before + np.outer(root, root)), atol=1e-12)
    return np.asarray(added)


@given(st.integers(0, 2**31))
@settings(max_examples=30)
def test_a_correction_turns_with_the_axes_of_the_camera(seed: int) -> None:
    past, turn = make_velocity_past(seed), Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    joints, earlier = past.joints @ turn.T, past.earlier @ turn.T
    turned = VelocityPast(past.velocity @ turn.T, past.std, joints, earlier, turn @ past.axes)
    one, other = map(find_correction, (past, turned))
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one @ turn.T, other, atol=1e-4)


def test_without_a_past_nothing_is_corrected() -> None:
    past = make_velocity_past(0)
    assert find_correction(past).any()
    for n, span in enumerate(SPANS):
        earlier = past.earlier.copy()
        earlier[:, n:] = np.nan
        correction = find_correction(past._replace(earlier=earlier))
        assert np.isfinite(correction).all()
        assert bool(correction.any()) == (span > LEAST_PAST_S)
    unknown = np.full((1, 15, 3), np.nan)
    load_velocity_correction().correct(
        past._replace(velocity=unknown, std=unknown[..., 0].copy()), np.zeros((1, 3, 3))
    )
    assert np.isnan(unknown).all()


@pytest.mark.parametrize('jitter', [0.05, 1e30])
def test_a_correction_is_limited_by_what_the_filter_does_not_know(jitter: float) -> None:
    for seed in range(20):
        past = make_velocity_past(seed, jitter)
        correction = np.linalg.norm(find_correction(past), axis=2)
        assert (correction <= MAX_CORRECTION * past.std * (1 + 1e-9)).all()


WALK = load_base_poses('walk')  # aligned by heading: z is up in every pose


def find_upward_plainly(pose: np.ndarray) -> np.ndarray:
    at = {name: pose[i] for i, name in enumerate(CMU15.joints)}
    lever = MASSES @ pose - (at['lankle'] + at['rankle']) / 2
    ahead = np.cross(at['lhip'] - at['rhip'] + at['lshoulder'] - at['rshoulder'], lever)
    legs = [np.linalg.norm(at[s + a] - at[s + b]) for s in 'lr' for a, b in (('hip', 'knee'), ('knee', 'ankle'))]
    length = np.linalg.norm(at['neck'] - at['pelvis']) + sum(legs) / 2
    upward = lever - SUPPORT_AHEAD * length * ahead / np.linalg.norm(ahead)
    return upward / np.linalg.norm(upward)


def test_the_kernel_computes_the_formula(rng: np.random.Generator) -> None:
    poses = rng.normal(size=(5, 15, 3))
    assert Stances.of(poses).upward == pytest.approx(np.array([find_upward_plainly(p) for p in poses]), abs=1e-12)


def test_walkers_show_the_vertical(rng: np.random.Generator) -> None:
    poses = WALK.poses(0.7 * rng.normal(size=(20, len(WALK.std))) * WALK.std)
    angles = np.degrees(np.arccos(Stances.of(poses).upward[:, 2]))
    assert np.median(angles) < 4, 'degrees; 3.2 over all motions of the training persons'

    assert np.isnan(Stances.of(np.full((1, 15, 3), np.nan)).upward).all()
    assert Stances.of(np.zeros((0, 15, 3))).upward.shape == (0, 3)


POSTERIOR_STD = np.array([[0.01, 0.01, 0.05]])  # m
SEEN = np.array([[1.0, 0.0, 1.0]])  # scores
LIFTER_STD = np.array([[[0.02, 0.03, 0.06], [0.02, 0.03, 0.06], [np.nan] * 3]])  # m; 0.07 m together
UNLIFTED = np.full((1, 3, 3), np.nan)


def estimate_joint_std(posterior: np.ndarray, lifted_std: np.ndarray, noise: float = 0.0) -> np.ndarray:
    joints, size = np.ones((1, 3, 3)), np.array([[1.0, 0.0, 0.0]])
    seen = ExtremityEvidence(joints, joints, lifted_std, joints, SEEN, np.full(1, noise))
    return np.asarray(describe_cores(posterior, seen, joints, size, np.zeros((1, 3)), np.array([0, 1]))[0][0])


def test_the_lifter_decides_where_it_lifted_and_noise_and_hiding_make_joints_less_certain() -> None:
    posterior = estimate_joint_std(POSTERIOR_STD, UNLIFTED)
    seen, inferred, not_lifted = estimate_joint_std(POSTERIOR_STD, LIFTER_STD)
    noisy = estimate_joint_std(POSTERIOR_STD, LIFTER_STD, 0.03)
    assert posterior[1] > posterior[0] > 0.011
    assert inferred > seen
    assert (seen, inferred) == pytest.approx((0.65 * 0.06 * 1.5**0.5, 0.8 * 0.07))
    assert not_lifted == posterior[2]
    assert noisy[0] > seen
    assert noisy[1:].tolist() == [inferred, not_lifted], 'the image says nothing of it, and the posterior knows it'
    assert estimate_joint_std(np.zeros((1, 3)), UNLIFTED) == pytest.approx(0.011)


def test_covariances_are_longest_along_the_line_of_sight(rng: np.random.Generator) -> None:
    position = rng.normal(size=(4, 3))
    covariance = compute_joint_covariance(np.full(4, 0.3), position)
    values, vectors = np.linalg.eigh(covariance)
    assert values.sum(axis=1) == pytest.approx(np.full(4, 0.09))
    assert np.abs((vectors[..., 2] * position).sum(axis=1)) == pytest.approx(np.linalg.norm(position, axis=1))
