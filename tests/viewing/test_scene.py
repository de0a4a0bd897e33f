# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes: undone swaps and the space that they fill; pictures, and the images behind the points."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.spatial.transform import Rotation

from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.cli.view import POSES, save_picture
from mocap_ros.config import NodeConfig, RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import KeypointSequence, save_sequence
from mocap_ros.formats.video import VideoReader
from mocap_ros.messages.images import IMAGE
from mocap_ros.runtime.load_scene import read_images
from mocap_ros.skeleton import CMU15
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing import plots
from mocap_ros.viewing import scene as scenes
from mocap_ros.viewing.overlay import MAX_OFFSET_S, Overlay, StampedImage, find_frame, reduce_images
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Scene, SceneKeypoints, ScenePerson, SidedPoints
from tests.support.blob_people import write_video
from tests.support.bodies import make_swinging_body
from tests.support.camera_messages import encode_pixels
from tests.support.foreign_messages import create_blank_message
from tests.support.input_files import QUICK_OPTIONS
from tests.support.message_objects import encode
from tests.support.scenes import INTRINSICS, make_keypoints, make_scene, make_scene_person, write_and_open

MIRROR = list(CMU15.mirror)
LEGS = [CMU15.index(side + joint) for side in 'lr' for joint in ('hip', 'knee', 'ankle')]


def find_swaps(person: ScenePerson, *inputs: SceneKeypoints) -> np.ndarray:
    return scenes.find_undone_swaps(person, SidedPoints.find(inputs))


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
    corners = scenes.image_corners((640, 480), INTRINSICS)
    assert INTRINSICS.project(corners) == pytest.approx(np.array([[0, 0], [640, 0], [640, 480], [0, 480]]))
    scene = make_scene()
    assert scene.centre == pytest.approx([0, 0.1, 4.5], abs=0.5)
    assert 1.5 < scene.extent < 3
    assert scene.floor_y == pytest.approx(0.95, abs=0.15)
    assert replace(scene, camera_height=1.3).floor_y == 1.3
    nameless = replace(scene.people[1], joints=np.full_like(scene.people[1].joints, np.nan))
    alone, with_unknown = (replace(scene, people=(scene.people[0], *more)) for more in ((), (nameless,)))
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


def test_a_picture_shows_the_person_seen_most_where_there_is_a_skeleton(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(plots, 'save_figure', lambda figure, _: figures.append(figure))
    frames = range(101, 200, 3)
    anna, ben = make_scene_person('anna', range(20), (0, 0, 4)), make_scene_person('ben', frames, (1, 0, 4))
    scene = replace(make_scene(300), people=(anna, ben), keypoints=(make_keypoints([ben]),))
    save_picture(scene, Path('picture.png'))
    words = [text.get_text() for text in figures[0].findobj(Text)]
    assert not {'no skeleton', 'not detected'} & {*words}
    shown = [word for word in words if word.endswith(' s')]
    assert len(shown) == POSES
    assert (shown[0], shown[-1]) == tuple(f'{scene.times[frame]:.2f} s' for frame in (frames[0], frames[-1]))
    predicted = replace(ben, predicted=ben.frames == frames[3])
    points = replace(scene, people=(predicted,), keypoints=(make_keypoints([anna, ben]),)).to_plot_data().keypoints
    assert points is not None
    is_shown = [int(frame) for frame in np.flatnonzero(points[..., 2].any(axis=1))]
    assert is_shown == [frame for frame in frames if frame != frames[3]], 'none of another person'
    nameless = replace(ben, joints=np.full_like(ben.joints, np.nan))
    with pytest.raises(InputError, match=scene.title):
        save_picture(replace(scene, people=(anna, nameless)), Path('picture.png'))


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


IMAGES = 40
SIZE = (480, 640, 3)
# The grey value of an image by a canvas pixel near its corner, in which nothing is drawn
READ_CORNER = """(() => {
  const canvas = document.getElementById('image-view'), [w, h] = mocapPage.scene.camera.imageSize;
  const scale = Math.min(canvas.width / w, canvas.height / h);
  const x = (canvas.width - w * scale) / 2 + 8, y = (canvas.height - h * scale) / 2 + 8;
  return canvas.getContext('2d').getImageData(x, y, 1, 1).data[0];
})()"""


def make_images(scene: Scene) -> list[StampedImage]:
    """Return an image for each frame, whose grey value is five times the frame."""
    return [StampedImage(s, np.full(SIZE, 5 * i, np.uint8)) for i, s in enumerate(scene.stamps_ns)]


def test_the_page_shows_the_image_of_the_frame_behind_its_points(tmp_path: Path, page: Any) -> None:
    scene = make_scene(IMAGES)
    images = make_images(scene)
    whole = sum(map(len, reduce_images(scene, images).jpegs))
    for step, max_bytes in ((1, whole), (4, whole // 3)):
        reduced = reduce_images(scene, images, max_bytes)
        assert (reduced.step, sum(map(len, reduced.jpegs)) <= max_bytes) == (step, True)
        path = tmp_path / f'{step}.html'
        write_and_open(page, path, build_page(replace(scene, images=reduced)))
        page.wait_for_selector('body[data-ready]')
        for frame in (0, 21, 39, 6):
            page.evaluate(f'mocapPage.showTime({scene.times[frame]})')
            shown = frame // step * step
            for _ in range(100):
                if page.evaluate('mocapPage.imageFrame()') == shown:
                    break
                page.wait_for_timeout(50)
            assert page.evaluate('mocapPage.imageFrame()') == shown
            assert page.evaluate(READ_CORNER) == pytest.approx(5 * shown, abs=3)


def test_an_image_belongs_to_the_nearest_frame() -> None:
    scene = make_scene(IMAGES)
    far = round((MAX_OFFSET_S + 0.01) * NS_PER_S)
    stamps = [scene.stamps_ns[3] + 10_000_000, scene.stamps_ns[-1] + far, scene.stamps_ns[0] - far]
    assert [find_frame(scene, stamp) for stamp in stamps] == [3, -1, -1]


def test_a_film_and_a_picture_show_points_in_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = make_scene(IMAGES)
    points = np.concatenate([scene.people[0].image, np.ones((IMAGES, 15, 1), np.float32)], axis=-1)
    save_sequence(tmp_path / 'in.npz', KeypointSequence(points, CMU15.joints, scene.times, (640, 480)))
    times = [i / 30 for i in range(IMAGES)]
    video = write_video(tmp_path / 'in.mkv', [image for _, image in make_images(scene)], times)
    arguments = ['view', str(tmp_path / 'in.npz'), '--video', str(video), *QUICK_OPTIONS, '-o']
    for name in ('film.mp4', 'picture.png'):
        assert main([*arguments, str(tmp_path / name)]) == 0
    with VideoReader(tmp_path / 'film.mp4') as reader:
        film = list(reader)
    assert [round(30 * time_s) for _, time_s in film] == [*range(IMAGES)]
    stamps = np.array(scene.times) + 9.0
    save_sequence(tmp_path / 'late.npz', KeypointSequence(points, CMU15.joints, stamps, (640, 480)))
    late = ['view', str(tmp_path / 'late.npz'), '--video', str(video), *QUICK_OPTIONS]
    assert main([*late, '-o', str(tmp_path / 'late.html')]) == 0
    assert 'in.mkv: no image is at the time of a frame' in capsys.readouterr().err
    for frame in (0, 20, 39):
        image = film[frame].image.astype(int)
        assert image[:20, :20].mean() == pytest.approx(5 * frame, abs=6)
        drawn = np.ptp(image, axis=-1) > 60  # blue and red bones
        x, y = np.nanmean(points[frame, :, :2], axis=0)
        assert drawn.sum() > 300
        assert np.argwhere(drawn).mean(axis=0) == pytest.approx([y, x], abs=40)


def test_a_film_without_images_is_white_and_one_without_pyav_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(5)
    (_, first), *rest = Overlay(scene).draw_film(())
    assert len(rest) == 4
    assert (first[0, 0] == 255).all()
    assert (first < 100).any()
    short = replace(make_recording().sequence(), truth=None)
    short = replace(short, keypoints=short.keypoints[:12], timestamps=short.timestamps[:12])
    save_sequence(tmp_path / 'short.npz', short)
    monkeypatch.setitem(sys.modules, 'av', None)
    assert main(['view', str(tmp_path / 'short.npz'), *QUICK_OPTIONS, '-o', str(tmp_path / 'film.mp4')]) == 1
    assert "film.mp4: a film needs PyAV: pip install -e '.[video]'" in capsys.readouterr().err


def test_the_images_of_a_bag_are_those_of_its_camera(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for frame in range(4):
            for topic, grey in (('/depth/image', 9), ('/image', 40 + frame)):
                message = create_blank_message(IMAGE)
                fields = encode_pixels(np.full((6, 8, 3), grey, np.uint8), 'rgb8')
                fields |= {'encoding': 'none'} if frame == 2 else {}
                for name, value in fields.items():
                    setattr(message, name, np.frombuffer(value, np.uint8) if name == 'data' else value)
                message.header.stamp.sec = frame + 1
                recorder.write(topic, IMAGE, encode(message, IMAGE), frame, frame)
    notes: list[str] = []
    images = [*read_images(tmp_path / 'bag', NodeConfig(), None, notes)]
    assert [(i.stamp_ns, int(i.image[0, 0, 0])) for i in images] == [(s * NS_PER_S, 39 + s) for s in (1, 2, 4)]
    (note,) = notes
    assert "/image: 1 images left out; encoding: 'none'" in note
