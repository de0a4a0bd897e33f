# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples for robots, against a recorded scene: the demo's person, in the frame of a robot with a camera."""

from __future__ import annotations

from copy import deepcopy
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.config import with_values
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.camera_infos import camera_info
from tests.support.modules import load_module
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, read_messages, write_keypoints_bag

FRAMES = 60


def load(name: str) -> ModuleType:
    return load_module(ROOT / 'examples' / f'{name}.py')


@pytest.fixture(scope='module')
def scene(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """Return the skeletons of a recorded scene in the robot's frame: x ahead of the camera, z up."""
    folder = tmp_path_factory.mktemp('scene')
    write_keypoints_bag(folder / 'bag', encode_demo_frames(FRAMES), camera_info())
    values = {'node.output_frame': 'base_link', 'node.camera_pose': '0 0 1.5 0 0 0'}
    with Bag(folder / 'bag') as bag:
        replay(bag, folder / 'out', ReplayOptions(with_values(FAST_CONFIG, values)))
    return [decode(raw, SKELETONS) for raw in read_messages(folder / 'out', '/skeletons')]


def move(skeletons: Any, ahead_m: float, velocity_m_s: float) -> None:
    """Move the person of a message so that the root is so far ahead, and let all joints move along x."""
    (person,) = skeletons.people
    dx, dy = ahead_m - person.root.x, -person.root.y
    for point in (person.root, *person.joints):
        point.x, point.y = point.x + dx, point.y + dy
    for velocity in (person.root_velocity, *person.joint_velocity):
        velocity.x, velocity.y, velocity.z = velocity_m_s, 0.0, 0.0


def test_a_robot_stops_for_a_person_who_comes_near_and_not_for_one_who_is_far(scene: list[Any]) -> None:
    example, skeletons = load('stop_when_near'), deepcopy(scene[-1])
    assert all(np.isfinite(example.nearest_distance(s)) for s in scene[5:])
    stops = sum(example.must_stop(s) for s in scene[5:])  # the person walks some metres away
    assert stops <= 2, 'a velocity that is wrong for a frame may stop the robot for that frame'
    move(skeletons, 3.0, 0.0)
    assert not example.must_stop(skeletons)
    move(skeletons, 3.0, -4.0)  # will be 1 m away
    assert example.must_stop(skeletons)
    move(skeletons, 3.0, 4.0)
    assert not example.must_stop(skeletons)
    move(skeletons, 0.9, 0.0)
    assert example.must_stop(skeletons)
    skeletons.people[0].tentative = True
    assert not example.must_stop(skeletons)


def test_a_robot_follows_a_person_and_stands_without(scene: list[Any]) -> None:
    example, skeletons = load('follow_person'), deepcopy(scene[-1])
    person = example.choose_person(skeletons)
    assert person.id == example.choose_person(skeletons, 'another').id
    person.tentative = False
    move(skeletons, 3.0, 0.0)
    speed, turn = example.choose_command(person)
    assert (speed, turn) == (example.MAX_SPEED_M_S, 0.0)
    person.root.y = 1.0
    assert example.choose_command(person)[1] > 0  # to the left
    move(skeletons, example.DISTANCE_M, 0.0)
    assert example.choose_command(person) == (pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-9))
    person.unseen_for = 1.0
    assert example.choose_command(example.choose_person(skeletons)) == (0.0, 0.0)


def test_a_costmap_gets_discs_where_people_are_and_will_be(scene: list[Any]) -> None:
    example, skeletons = load('people_layer'), deepcopy(scene[-1])
    skeletons.people[0].tentative = False
    move(skeletons, 3.0, 1.0)
    points = np.array(example.list_points(skeletons)).reshape(len(example.AHEAD_S), -1, 3)
    np.testing.assert_allclose(
        points.mean(axis=1), [[3 + t, 0, example.HEIGHT_M] for t in example.AHEAD_S], atol=1e-9
    )
    skeletons.people[0].tentative = True
    assert example.list_points(skeletons) == []


def test_people_in_the_frame_of_the_camera_move_no_robot(scene: list[Any]) -> None:
    """The node publishes such people where it knows no transform; their x and y are not on the ground."""
    skeletons = deepcopy(scene[-1])
    skeletons.people[0].tentative = False
    skeletons.header.frame_id = skeletons.camera_frame_id
    assert load('stop_when_near').must_stop(skeletons)
    assert load('follow_person').choose_person(skeletons) is None
    assert load('people_layer').list_points(skeletons) == []
