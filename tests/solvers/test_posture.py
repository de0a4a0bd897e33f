# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Postures of bodies that are bent and laid down by known angles, and how they follow each other."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.level import MAX_CERTAIN_STD
from mocap_ros.people import Posture
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.posture import (
    FORGET_S,
    STATE,
    find_postures,
    follow_postures,
    measure_likelihood,
    name_postures,
)
from tests.support.bodies import UPRIGHT

UP, STD = np.array([[0.0, 0.0, 1.0]]), np.array([0.02])
LEGS = [CMU15.index(side + joint) for side in 'lr' for joint in ('knee', 'ankle')]
# Degrees by which thigh, shank, trunk and then the whole body are turned about the axis to the left: the head goes
# forwards, the end of a leg backwards.
BODIES = {
    'upright': (0, 0, 0, 0, Posture.STANDING),
    'in a stride': (-20, 20, 0, 0, Posture.STANDING),
    'on a chair': (-90, 0, 0, 0, Posture.SITTING),
    'on the floor': (-90, -90, 0, 0, Posture.SITTING),
    'squatting': (-70, 45, 40, 0, Posture.CROUCHING),
    'on the back': (0, 0, 0, -90, Posture.LYING),
    'with raised knees': (-45, 45, 0, -90, Posture.LYING),
    'on the front': (0, 0, 0, 90, Posture.LYING),
    'on the hands': (0, 0, 0, 180, Posture.UNKNOWN),
    'on hands and knees': (0, 90, 90, 0, Posture.UNKNOWN),
}


def pose(body: str) -> np.ndarray:
    """Return the joints (15, 3) of one of `BODIES`."""
    thigh, shank, trunk, whole = (Rotation.from_euler('y', a, degrees=True) for a in BODIES[body][:4])
    at = {name: UPRIGHT[n] for n, name in enumerate(CMU15.joints)}
    hips = (at['lhip'] + at['rhip']) / 2
    bent = {name: hips + trunk.apply(place - hips) for name, place in at.items()}
    for side in 'lr':
        hip, knee, ankle = (at[side + joint] for joint in ('hip', 'knee', 'ankle'))
        middle = hip + thigh.apply(knee - hip)
        bent |= {side + 'hip': hip, side + 'knee': middle, side + 'ankle': middle + shank.apply(ankle - knee)}
    return np.asarray(whole.apply([*bent.values()]))


def look(
    joints: np.ndarray, hidden: tuple[int, ...] = (), upward: np.ndarray = UP, std: np.ndarray = STD
) -> np.ndarray:
    """Return the likelihood (5,) of a pose with some joints hidden."""
    return measure_likelihood(joints[None], np.isin(np.arange(15), hidden)[None], upward, std)[0]


def follow(likelihood: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the postures (F,) at 30 Hz, and their probabilities, as a tracker finds them."""
    state, found = np.full((1, *STATE.shape), np.nan), []
    for frame, own in enumerate(likelihood):
        follow_postures(state, np.array([frame / 30]), own[None])
        found.append(np.concatenate(name_postures(state, np.array([frame / 30]))))
    posture, probability = np.transpose(found)
    return posture, probability


@pytest.mark.parametrize('body', BODIES)
def test_bodies_are_in_their_postures_in_every_frame(body: str) -> None:
    expected = BODIES[body][-1]
    turn = Rotation.from_euler('xyz', [100.0, 20.0, 60.0], degrees=True)
    likelihood = look(pose(body))
    turned = look(turn.apply(1.2 * pose(body)) + [1.0, 2.0, 3.0], upward=turn.apply(UP))
    np.testing.assert_allclose(turned, likelihood, atol=1e-9)
    posture, probability = follow(np.tile(likelihood, (30, 1)))
    assert posture[-1] == expected
    assert (probability[-1] > 0.8) == (expected is not Posture.UNKNOWN)


def test_nothing_is_known_without_legs_or_the_vertical() -> None:
    body = pose('upright')
    assert np.isnan(look(body, (*LEGS,))).all()
    assert look(body, (*LEGS[:2],)).argmax() == Posture.STANDING
    assert np.isnan(look(body, std=np.array([1.01 * MAX_CERTAIN_STD]))).all()
    assert np.isnan(look(body, upward=np.nan * UP)).all()


def test_a_fall_is_seen_within_a_second_and_one_wrong_pose_is_none() -> None:
    stands, lies = look(pose('upright')), look(pose('on the back'))
    likelihood = np.array([stands] * 60 + [lies] + [stands] * 30 + [lies] * 60)
    expected = np.repeat([Posture.STANDING, Posture.LYING], [91, 60])
    is_late = follow(likelihood)[0] != expected
    assert not is_late[:91].any()
    assert 0 < is_late.sum() < 20
    posture, _ = find_postures(np.arange(151) / 30, likelihood)
    assert (posture == expected).all(), 'a whole sequence knows what comes'


def test_a_posture_is_forgotten_while_legs_are_hidden() -> None:
    sits, stands = look(pose('on a chair')), look(pose('upright'))
    likelihood = np.array([sits] * 30 + [np.full(5, np.nan)] * 30 + [stands] * 30)
    for found in (follow(likelihood)[0], find_postures(np.arange(90) / 30, likelihood)[0]):
        is_recent = np.arange(1, 31) / 30 <= FORGET_S
        assert found[30:60].tolist() == np.where(is_recent, Posture.SITTING, Posture.UNKNOWN).tolist()
        assert found[-1] == Posture.STANDING
