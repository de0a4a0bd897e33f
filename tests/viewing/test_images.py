# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The images behind the points: from videos and bags, in step on the page, and as films and pictures."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import NodeConfig, RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import KeypointSequence, save_sequence
from mocap_ros.formats.video import VideoReader
from mocap_ros.messages.cdr import encode
from mocap_ros.messages.images import IMAGE
from mocap_ros.runtime.scene_images import read_images
from mocap_ros.skeleton import CMU15
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.overlay import MAX_OFFSET_S, Overlay, StampedImage, find_frame, reduce_images
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Scene
from tests.support.blob_people import write_video
from tests.support.foreign_messages import create_blank_message
from tests.support.image_messages import encode_pixels
from tests.support.keypoint_files import QUICK_OPTIONS
from tests.support.scenes import make_scene, write_and_open

FRAMES = 40
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
    scene = make_scene(FRAMES)
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
    scene = make_scene(FRAMES)
    far = round((MAX_OFFSET_S + 0.01) * NS_PER_S)
    stamps = [scene.stamps_ns[3] + 10_000_000, scene.stamps_ns[-1] + far, scene.stamps_ns[0] - far]
    assert [find_frame(scene, stamp) for stamp in stamps] == [3, -1, -1]


def test_a_film_and_a_picture_show_the_points_in_the_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(FRAMES)
    points = np.concatenate([scene.people[0].image, np.ones((FRAMES, 15, 1), np.float32)], axis=-1)
    save_sequence(tmp_path / 'in.npz', KeypointSequence(points, CMU15.joints, scene.times, (640, 480)))
    times = [i / 30 for i in range(FRAMES)]
    video = write_video(tmp_path / 'in.mkv', [image for _, image in make_images(scene)], times)
    arguments = ['view', str(tmp_path / 'in.npz'), '--video', str(video), *QUICK_OPTIONS, '-o']
    for name in ('film.mp4', 'picture.png'):
        assert main([*arguments, str(tmp_path / name)]) == 0
    with VideoReader(tmp_path / 'film.mp4') as reader:
        film = list(reader)
    assert [round(30 * time_s) for _, time_s in film] == [*range(FRAMES)]
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
