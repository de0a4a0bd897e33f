# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.geometry.level import Floor, build_world
from mocap_ros.offline.whole_sequence import SequenceResult, share_floor
from mocap_ros.skeleton import BODY26
from mocap_ros.solvers.floor import HEEL_M, SIZE_RANGE, TOE_M, FloorFit, Stander, fit_floor
from tests.support.bodies import UPRIGHT

FRAMES, CAMERA_HEIGHT_M = 240, 1.6
TIMES = np.arange(FRAMES) / 30
UPWARD = Rotation.from_euler('xz', [-12.0, 3.0], degrees=True).apply([0.0, -1.0, 0.0])
CONTACT = np.ones((FRAMES, 4))
SEEN_TWICE = np.where(np.arange(FRAMES) < 2, 1.0, np.nan)[:, None, None]


def stand(camera_height: float = CAMERA_HEIGHT_M) -> Array:
    """Joints (F, 26, 3) m in the camera of a person who slides about on a floor, from 3 to 6 m away."""
    body = np.zeros((26, 3))  # m, over the floor: x right, y ahead, z up
    body[:15] = UPRIGHT[:, [1, 0, 2]] * [-1, 1, 1]
    for side in 'lr':
        x = body[BODY26.index(side + 'ankle'), 0]
        body[BODY26.index(side + 'heel')] = x, -0.05, HEEL_M
        body[BODY26.index(side + 'toe')] = x, 0.2, TOE_M
    way = np.stack([np.sin(TIMES), 4.5 + 1.5 * np.cos(0.8 * TIMES), 0 * TIMES], axis=1)
    in_world = body + way[:, None] - [0.0, 0.0, camera_height]
    level = in_world * [1, 1, -1]
    return level[..., [0, 2, 1]] @ Rotation.align_vectors([UPWARD], [[0.0, -1.0, 0.0]])[0].as_matrix().T


def fit_to(joints: Array, floor: Floor) -> FloorFit:
    fit = fit_floor([Stander(joints, CONTACT, TIMES)], floor, 0.08)
    assert fit is not None
    return fit


def test_a_known_height_gives_size_distance_and_vertical() -> None:
    true = stand()
    wrong_depth = 1 + 0.02 * np.sin(TIMES / 0.7)[:, None, None]
    joints = true / 1.12 * wrong_depth
    lean = Rotation.from_rotvec([0.02, 0.0, 0.0]).apply(UPWARD)
    fit = fit_to(joints, Floor(lean, CAMERA_HEIGHT_M, math.radians(2)))
    assert fit.sizes[0] == pytest.approx(1.12, abs=0.03)
    assert math.acos(fit.floor.upward @ UPWARD) < 0.006 < 0.02
    exact = fit_to(joints, Floor(UPWARD, CAMERA_HEIGHT_M))
    assert exact.sizes[0] == pytest.approx(1.12, abs=0.01)
    placed = exact.place(0, joints)
    assert np.abs(placed - true).max() < 0.1
    assert np.abs(placed - true).mean() < 0.6 * np.abs(joints * 1.12 - true).mean()

    for height, low, high in ((3.2, SIZE_RANGE[1], math.inf), (0.4, 0.0, SIZE_RANGE[0])):
        wrong = fit_to(joints, Floor(UPWARD, height))
        assert low < wrong.sizes[0] <= high


def test_a_floor_is_found_by_feet_and_leaves_the_size() -> None:
    fit = fit_to(stand(), Floor(UPWARD, None, math.radians(4)))
    assert fit.sizes[0] == 1.0
    assert fit.floor.camera_height == pytest.approx(CAMERA_HEIGHT_M, abs=0.01)
    assert 0.08 * CAMERA_HEIGHT_M < fit.floor.height_std < 0.3
    assert fit.floor.tilt_std < math.radians(4)
    world = build_world(stand(), fit.floor.upward, fit.floor.camera_height)
    in_world = stand() @ world[:3, :3].T + world[:3, 3]
    assert in_world[:, BODY26.index('lheel'), 2] == pytest.approx(HEEL_M, abs=0.01)
    assert in_world[0, BODY26.index('pelvis'), :2] == pytest.approx(0.0, abs=1e-9)
    ahead = in_world[0, BODY26.index('ltoe')] - in_world[0, BODY26.index('lheel')]
    assert ahead[:2] == pytest.approx([0.25, 0.0], abs=1e-6)
    assert world[:3, :3] @ world[:3, :3].T == pytest.approx(np.eye(3))
    assert np.linalg.det(world[:3, :3]) == pytest.approx(1.0)


def test_several_people_stand_on_one_floor_in_one_world() -> None:
    people = [stand() * 0.95, (stand() + np.cross(UPWARD, [0.0, 0.0, 1.0])) * 1.05]
    found = []
    for joints in people:
        vertical, std = np.tile(UPWARD, (FRAMES, 1)), np.full(FRAMES, math.radians(3.0))
        rest: Any = np.ones((FRAMES, 26), bool), BODY26, '', None, None, vertical, std
        found.append(replace(SequenceResult(joints, *rest), contact=CONTACT))
    lain = Rotation.from_rotvec([0.1, 0.0, 0.0]).apply(found[0].vertical)
    found.append(replace(found[0], contact=CONTACT * np.nan, vertical=lain, vertical_std=2 * TIMES))
    above = replace(found[1], joints=found[1].joints + 0.8 * UPWARD)
    for people_found in ([found[0], above], [above, found[0]]):  # one stands on a platform
        apart = share_floor(people_found, [TIMES] * 2, TrackerConfig())
        assert [(r.size, r.floor, r.height_note) for r in apart] == [(1.0, None, '')] * 2
    opposite = replace(found[1], vertical=-found[0].vertical)
    assert all(r.floor is None for r in share_floor([found[0], opposite], [TIMES] * 2, TrackerConfig()))
    first, second, unknown = share_floor(found, [TIMES] * 3, TrackerConfig())
    assert (unknown.vertical == first.vertical).all()
    assert (unknown.size, unknown.floor) == (1.0, first.floor)
    assert (unknown.world_from_camera == first.world_from_camera).all()
    assert (first.size, second.size) == pytest.approx((1 / 0.95, 1 / 1.05), abs=0.015)
    heights = [result.floor and result.floor.camera_height for result in (first, second)]
    assert heights == pytest.approx([CAMERA_HEIGHT_M] * 2, rel=0.03)
    assert (first.world_from_camera == second.world_from_camera).all()
    for result, joints, size in ((first, people[0], 1 / 0.95), (second, people[1], 1 / 1.05)):
        world = result.world_from_camera
        heels = result.joints[:, BODY26.index('lheel')] @ world[:3, :3].T + world[:3, 3]
        assert heels[:, 2] == pytest.approx(HEEL_M, abs=0.02)
        bodies = [np.linalg.norm(j[:, 0] - j[:, 1], axis=1).mean() for j in (result.joints, joints)]
        assert bodies[0] / bodies[1] == pytest.approx(size, abs=0.015)


def sit(joints: Array) -> Array:
    """Return joints with the knees in front of the hips."""
    bent = joints.copy()
    for side in 'lr':
        hip, knee = BODY26.index(side + 'hip'), BODY26.index(side + 'knee')
        bent[:, knee] = bent[:, hip]
        bent[:, knee, 2] -= np.linalg.norm(joints[:, knee] - joints[:, hip], axis=1)
    return bent


@pytest.mark.parametrize(
    ('joints', 'contact', 'tilt_deg'),
    [
        pytest.param(stand(), CONTACT * 0.5, 3.0, id='no foot stands'),
        pytest.param(stand(), CONTACT * np.nan, 3.0, id='feet not seen'),
        pytest.param(stand() * np.nan, CONTACT, 3.0, id='not seen'),
        pytest.param(stand() * SEEN_TWICE, CONTACT, 3.0, id='two frames'),
        pytest.param(stand(), CONTACT, 25.0, id='vertical not known'),
        pytest.param(stand(), CONTACT, math.nan, id='no vertical'),
        pytest.param(sit(stand()), CONTACT, 3.0, id='seated'),
        pytest.param(stand(-1.0), CONTACT, 3.0, id='above the camera'),
    ],
)
def test_nothing_shows_a_floor(joints: Array, contact: Array, tilt_deg: float) -> None:
    assert fit_floor([Stander(joints, contact, TIMES)], Floor(UPWARD, None, math.radians(tilt_deg)), 0.08) is None


def test_a_world_without_floor_or_vertical() -> None:
    joints = stand()
    joints[:5] = np.nan
    world = build_world(joints, np.full(3, np.nan), None)
    in_world = joints @ world[:3, :3].T + world[:3, 3]
    assert in_world[5, BODY26.index('pelvis'), :2] == pytest.approx(0.0, abs=1e-9)
    assert np.nanpercentile(in_world[..., 2].min(axis=1), 5) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(build_world(joints * np.nan, UPWARD, 1.0)).all()
