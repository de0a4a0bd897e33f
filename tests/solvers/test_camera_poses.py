# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Poses and clocks of cameras, from the people whom they see."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.people import PoseSequence
from mocap_ros.solvers.camera_poses import find_camera_poses, find_line_distances
from mocap_ros.solvers.seen_people import SeenPerson, find_clock_offsets
from tests.support.walkers import Camera, make_bodies, place_camera, see, watch

CAMERAS = (
    place_camera(0),
    place_camera(60, rate_hz=15.0, clock_s=3.217, pitch=0.15),
    place_camera(130, distance=5.0, rate_hz=10.0, clock_s=-1e9),
)


def view_all(people: int, seconds: float = 12.0) -> list[list[PoseSequence]]:
    """Return the people of each of `CAMERAS`, in other orders."""
    return [see(camera, range(people)[:: 1 - 2 * (c % 2)], seconds, c) for c, camera in enumerate(CAMERAS)]


def relate(cameras: tuple[Camera, ...]) -> Array:
    poses = np.array([camera.pose for camera in cameras])
    return np.asarray(np.linalg.inv(poses[0]) @ poses)


@pytest.mark.parametrize('people', [1, 2])
@pytest.mark.parametrize('with_keypoints', [True, False])
def test_cameras_are_where_their_people_say(people: int, with_keypoints: bool) -> None:
    views, truth = view_all(people), relate(CAMERAS)
    if not with_keypoints:
        views = [[replace(person, sequence=None) for person in view] for view in views]
    found = find_camera_poses(views)
    turns = vector_from_rotation(np.swapaxes(found.poses[:, :3, :3], 1, 2) @ truth[:, :3, :3])
    angles = np.linalg.norm(turns, axis=1)
    places, true_places = found.poses[:, :3, 3], truth[:, :3, 3]
    scale = (places * true_places).sum() / (places**2).sum()
    assert np.array_equal(found.poses[0], np.eye(4))
    assert (angles < [1e-9, 0.01, 0.01]).all()
    assert (angles <= 3 * found.rotation_std + 1e-9).all()
    errors = np.linalg.norm(scale * places - true_places, axis=1)
    assert (errors < 0.1).all()
    assert (errors <= 3 * found.translation_std + 1e-9).all()
    assert scale == pytest.approx(1, abs=0.05)
    assert found.clock_offsets == pytest.approx([0, -3.217, 1e9], abs=0.02)
    assert found.seconds[1:] == pytest.approx([12 * people] * 2, abs=0.5 * people)


def test_less_is_known_of_somebody_who_is_seen_for_a_shorter_time() -> None:
    stds = [find_camera_poses(view_all(1, seconds)[:2]).rotation_std[1] for seconds in (12.0, 4.0)]
    assert stds[1] > 1.3 * stds[0]


def test_a_person_who_is_lost_and_found_again_under_another_id_is_one() -> None:
    first, second, _ = view_all(1)
    person = second[0]
    early = person.times < person.times[60]
    parts = [replace(person.select(part), id=name) for part, name in ((early, 'a'), (~early, 'b'))]
    found = find_camera_poses([first, parts])
    assert found.seconds[1] > 11
    assert vector_from_rotation(found.poses[1, :3, :3].T @ relate(CAMERAS)[1, :3, :3]) == pytest.approx(
        0, abs=0.02
    )


def test_what_two_clocks_fit_alike_is_not_known() -> None:
    """Each of 16 rounds is the one before turned by half a radian, so that a round more turns the camera."""
    bodies, _ = make_bodies(0, 1.0, 30.0)
    turns = rotation_from_vector(np.array([[0, 0.5 * k, 0] for k in range(16)]))
    joints = np.concatenate([bodies @ turn.T for turn in turns])
    rng, times = np.random.default_rng(0), np.arange(len(joints)) / 30
    found = find_camera_poses([[watch(place_camera(angle), joints, times, rng)] for angle in (0.0, 60.0)])
    assert found.rotation_std[1] > 0.35


def test_cameras_that_see_nobody_at_one_time_are_refused() -> None:
    first, second, _ = view_all(1)
    with pytest.raises(InputError, match='camera 2'):
        find_camera_poses([first, [replace(second[0], joints=np.full_like(second[0].joints, np.nan))]])


def test_clock_offsets_are_finer_than_a_frame() -> None:
    first, second, _ = (SeenPerson.of(view[0], 0, TrackerConfig()) for view in view_all(1))
    best, *_ = find_clock_offsets(first, second)
    assert best.offset == pytest.approx(-3.217, abs=0.01)
    assert best.correlation > 0.8


def test_distances_of_lines_of_sight_are_those_by_which_points_are_moved() -> None:
    """Two cameras side by side see a point as far away: half of the squared shift of one is the other's."""
    pose = np.eye(4)
    pose[0, 3] = 0.5
    point, shift = np.array([0.25, 0.0, 4.0]), 0.02
    rays = [np.tile(p[:2] / p[2], (1, 15, 1)) for p in (point + [0, shift, 0], point - pose[:3, 3])]
    unknown = np.full((1, 15, 3), np.nan)
    first, second = (
        SeenPerson(np.zeros(1), np.tile(point, (1, 15, 1)), unknown[..., 0], unknown[:, :3], own, np.zeros(1))
        for own in rays
    )
    assert np.abs(find_line_distances(first, second, pose)) == pytest.approx(shift / np.sqrt(2), rel=1e-6)
    level = first._replace(rays=np.tile(point[:2] / point[2], (1, 15, 1)))
    assert find_line_distances(level, second, pose) == pytest.approx(0, abs=1e-12)
