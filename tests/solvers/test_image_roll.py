# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of cameras that are upside down, on their side or turned by any angle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.image_roll import CameraSide, find_sides, is_upside_down
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.tracker import Tracker
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS

FRAMES = 30
WRISTS = [CMU15.index(name) for name in ('lwrist', 'rwrist')]
STANDING, TURNED, OTHER = (True, False), (False, True), (False, False)


@pytest.fixture(scope='module')
def points(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, FRAMES)[2]


def turn(points: Array, roll: float, camera: Intrinsics = CAMERA) -> Array:
    """Return points (..., 2) px turned clockwise about the principal point by an angle in rad."""
    matrix = np.array([[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]])
    return (points - camera.center) @ matrix.T + camera.center


@pytest.mark.parametrize(
    ('angle_deg', 'wrists', 'unseen', 'expected'),
    [
        (0, 'down', (), STANDING),
        (30, 'down', (), STANDING),
        (90, 'down', (), OTHER),  # lies, or the camera is on its side
        (-170, 'down', (), TURNED),
        (180, 'raised', (), OTHER),  # stands on the hands
        (0, 'raised', (), STANDING),
        (180, 'down', ('lwrist',), TURNED),
        (180, 'down', ('lwrist', 'rwrist'), OTHER),
        (180, 'down', ('lknee', 'rknee', 'lankle', 'rankle'), TURNED),
        (180, 'down', ('head', 'neck', 'lshoulder', 'rshoulder'), OTHER),
    ],
)
def test_who_is_upside_down_and_not_on_the_hands_shows_the_camera_upside_down(
    points: Array, angle_deg: float, wrists: str, unseen: tuple[str, ...], expected: tuple[bool, bool]
) -> None:
    body = points[:1].copy()
    if wrists == 'raised':
        head, pelvis = (body[:, CMU15.index(name)] for name in ('head', 'pelvis'))
        body[:, WRISTS] = (head + 0.5 * (head - pelvis))[:, None]
    weight = np.where(np.isin(CMU15.joints, unseen), 0.0, 0.9)[None]
    rays = (turn(body, math.radians(angle_deg)) - CAMERA.center) / CAMERA.focal
    assert tuple(bool(side[0]) for side in find_sides(rays, weight)) == expected


def test_a_somersault_does_not_turn_a_camera_and_a_wrong_start_is_mended(points: Array) -> None:
    upright = points[:1] - CAMERA.center
    weight, times = np.ones((1, 15)), np.arange(60) / 30
    for turned, at_once, at_end in (
        (range(0), False, False),
        (range(10, 22), False, False),
        (range(2), True, False),
    ):
        side, found = CameraSide(), []
        for frame in range(60):
            side.advance(frame * STEP_NS, -upright if frame in turned else upright, weight)
            found.append(side.is_upside_down)
        assert (found[0], found[-1]) == (at_once, at_end)
        assert sum(np.diff(found)) <= 1
        body = np.where(np.isin(np.arange(60), turned)[:, None, None], -upright, upright)
        assert not is_upside_down(body, np.ones((60, 15)), times)
    assert is_upside_down(np.tile(-upright, (5, 1, 1)), np.ones((5, 15)), times[:5]), 'a short sequence'


@pytest.mark.parametrize(('roll_deg', 'is_given'), [(180, True), (90, True), (-35, True), (180, False)])
def test_people_before_a_turned_camera_are_those_before_an_upright_one_turned(
    walk_model: BasePoses, points: Array, roll_deg: float, is_given: bool
) -> None:
    """With the vertical given, and without for a camera that is upside down; whole and live."""
    roll = math.radians(roll_deg)
    rotation = Rotation.from_rotvec([0, 0, roll])
    found: list[list[Array]] = []
    for angle in (0.0, roll):
        up = Rotation.from_rotvec([0, 0, angle]).apply([0.0, -1.0, 0.0])
        config = with_values(Config(), {'tracker.vertical': ' '.join(map(str, up)) if is_given else 'auto'})
        keypoints = np.concatenate([turn(points, angle), np.full((FRAMES, 15, 1), 0.9)], axis=-1)
        times = np.arange(FRAMES) / 30
        whole = reconstruct_sequence(keypoints, CMU15.joints, times, CAMERA, walk_model, config)
        tracker = Tracker(walk_model, config)
        people = [Person2D('', CMU15.joints, k[:, :2], k[:, 2]) for k in keypoints]
        live = [tracker.update(f * STEP_NS, [p], CAMERA)[0].core for f, p in enumerate(people)]
        found.append([whole.core, np.array(live), whole.vertical])
    for upright, turned in zip(*found, strict=True):
        assert turned == pytest.approx(rotation.apply(upright.reshape(-1, 3)).reshape(upright.shape), abs=3e-3)
