# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes: undone swaps, colours and the space that they fill; pictures: the errors that they draw."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.skeleton import CMU15
from mocap_ros.viewing import plots
from mocap_ros.viewing.scene import SceneKeypoints, ScenePerson, SidedPoints, find_undone_swaps, image_corners
from tests.support.scenes import INTRINSICS, make_keypoints, make_scene, make_scene_person
from tests.support.swinging_body import make_swinging_body

MIRROR = list(CMU15.mirror)
LEGS = [CMU15.index(side + joint) for side in 'lr' for joint in ('hip', 'knee', 'ankle')]


def find_swaps(person: ScenePerson, *inputs: SceneKeypoints) -> np.ndarray:
    return find_undone_swaps(person, SidedPoints.find(inputs))


@pytest.mark.parametrize('joints', [list(range(15)), LEGS], ids=['whole body', 'legs'])
def test_an_undone_swap_is_found_in_its_frames_only(joints: list[int]) -> None:
    person = make_scene_person('anna', range(100), (0.0, 0.0, 4.0))
    keypoints = make_keypoints([person])
    noise = np.random.default_rng(0).normal(0, 4, keypoints.points.shape)  # px; a person of 260 px
    points = keypoints.points + noise.astype(np.float32)
    swapped = points.copy()
    swapped[4:6, joints] = points[4:6, [MIRROR[joint] for joint in joints]]
    assert not find_swaps(person, replace(keypoints, points=points)).any()
    assert np.flatnonzero(find_swaps(person, replace(keypoints, points=swapped))).tolist() == [4, 5]
    assert not find_swaps(person).any(), 'without detections'
    assert not find_swaps(person, replace(keypoints, frames=keypoints.frames + 100, points=swapped)).any()


def test_a_swap_of_another_person_is_not_taken_for_the_persons() -> None:
    anna, ben = (make_scene_person(name, range(10), (x, 0.0, 4.0)) for name, x in (('anna', -0.7), ('ben', 0.7)))
    own, other = make_keypoints([anna]), make_keypoints([ben])
    other = replace(other, points=other.points[:, MIRROR])
    assert not find_swaps(anna, other, own).any()
    assert find_swaps(ben, own, other).all()


def test_the_space_holds_the_people() -> None:
    corners = image_corners((640, 480), INTRINSICS)
    assert INTRINSICS.project(corners) == pytest.approx(np.array([[0, 0], [640, 0], [640, 480], [0, 480]]))
    scene = make_scene()
    assert scene.centre == pytest.approx([0, 0.1, 4.5], abs=0.5)
    assert 1.5 < scene.extent < 3
    assert scene.floor_y == pytest.approx(0.95, abs=0.15)
    assert replace(scene, camera_height=1.3).floor_y == 1.3
    nameless = replace(scene.people[1], joints=np.full_like(scene.people[1].joints, np.nan))
    alone, with_unknown = (
        replace(scene, people=scene.people[:1]),
        replace(scene, people=(scene.people[0], nameless)),
    )
    assert (with_unknown.extent, with_unknown.floor_y) == (alone.extent, alone.floor_y)
    empty = replace(scene, people=())
    assert np.isfinite([*empty.centre, empty.extent, empty.floor_y]).all()


def test_the_floor_is_level_where_the_camera_is_not() -> None:
    """A camera that looks down by 30 degrees: the floor is where a level camera would have it."""
    scene = make_scene()
    turn = Rotation.from_euler('x', -30, degrees=True).as_matrix()
    seen = [replace(p, joints=(p.joints @ turn.T).astype(np.float32)) for p in scene.people]
    tilted = replace(scene, people=tuple(seen), vertical=turn @ [0.0, -1.0, 0.0])
    assert tilted.floor_y == pytest.approx(scene.floor_y, abs=1e-4)
    assert tilted.to_plot_data().to_level @ turn == pytest.approx(np.eye(3), abs=1e-6), 'pictures are level, too'
    assert replace(tilted, vertical=np.full(3, np.nan)).floor_y != pytest.approx(scene.floor_y, abs=0.5)


FRAMES = 30


@pytest.fixture
def data() -> plots.PlotData:
    poses, times = make_swinging_body(FRAMES)
    truth = poses + [0.3, 0.1, 4.0]
    return plots.PlotData(
        times=times,
        keypoints=np.concatenate([truth[..., :2] * 100, np.ones((FRAMES, 15, 1))], axis=-1),
        keypoint_skeleton=CMU15,
        joints=truth,
        seen=np.ones((FRAMES, 15), bool),
        skeleton=CMU15,
        truth=truth,
    )


def read_errors_mm(data: plots.PlotData) -> np.ndarray:
    figure = plots.draw_poses_figure(data, [0, 10], 'title', ['a', 'b'])
    (line, *_) = figure.axes[-2].lines
    return np.asarray(line.get_ydata())


def test_the_error_is_that_of_the_centred_joints(data: plots.PlotData) -> None:
    assert read_errors_mm(replace(data, joints=data.joints + [0.5, 0, 1])) == pytest.approx(0, abs=1e-9)
    joints = data.joints.copy()
    joints[3, 0] += [0.15, 0, 0]  # the other 14 joints move by -10 mm with the centre
    errors = read_errors_mm(replace(data, joints=joints))
    assert errors[3] == pytest.approx((140 + 14 * 10) / 15)
    assert np.delete(errors, 3) == pytest.approx(0, abs=1e-9)
