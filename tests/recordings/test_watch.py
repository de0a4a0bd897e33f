# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`view --live CAMERA`: images become people on the page, the newest counts, and what was seen is recorded."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.cli import view
from mocap_ros.cli.main import main
from mocap_ros.config import Config, with_values
from mocap_ros.detectors.detector import load_detector
from mocap_ros.errors import InputError
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.video import VideoImage, VideoReader
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.recordings import watch
from mocap_ros.recordings.load_keypoints import load_people
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.live_page import LiveScene, PageServer
from mocap_ros.viewing.overlay import encode_jpeg
from tests.support.blob_people import draw, save_detector, walk, write_video


class FakeReader:
    """Reader of small images, some at once and then nothing more."""

    is_live = False

    def __init__(self, times_s: list[float], error: Exception | None = None) -> None:
        self._times_s, self._error = times_s, error

    def __iter__(self) -> Iterator[VideoImage]:
        for number, time_s in enumerate(self._times_s):
            yield VideoImage(np.full((2, 2, 3), number, np.uint8), time_s)
        if self._error is not None:
            raise self._error


def take_all(reader: Any, taken: list[int]) -> None:
    """Take the newest images, the first one slowly, until there are no more."""
    with watch.NewestImage(reader) as images:
        while True:
            if (shot := images.take()) is not None:
                taken.append(int(shot.image[0, 0, 0]))
                time.sleep(0.25 if len(taken) == 1 else 0.0)


def test_a_video_keeps_its_pace_and_images_are_skipped_not_queued() -> None:
    reader = FakeReader([0.0, 0.1, 0.2, 0.3, 0.4, 0.9], InputError('the camera has gone'))
    taken: list[int] = []
    start_s = time.monotonic()
    with pytest.raises(InputError, match='has gone'):
        take_all(reader, taken)
    assert time.monotonic() - start_s >= 0.85
    assert (taken[0], taken[-1]) == (0, 5)
    assert taken[1] >= 2
    assert not any(thread.name == 'camera' for thread in threading.enumerate())


def test_people_are_on_the_page_with_their_image(tmp_path: Path) -> None:
    scene = LiveScene('camera')
    models, config = load_base_pose_models('auto'), Config()
    watching = watch.Watch(
        load_detector(save_detector(tmp_path / 'detector.onnx')), models, config, scene, is_recorded=True
    )
    scene.wait(-1)  # a browser that asks
    people = walk(8)
    for frame, person in enumerate(people):
        shot = watch.Shot(draw([person]), NS_PER_S + round(frame * NS_PER_S / 30))
        watching.show(shot)
    assert b'"hasImage":true' in scene.wait(0)
    assert scene.find_image(len(people)).startswith(b'\xff\xd8')
    assert scene.find_image(1) == b'', 'only the newest are kept'
    detections = watching.collect()
    assert [len(seen) for seen in detections.people] == [1] * len(people)
    assert detections.stamps_ns[0] == 0
    with pytest.raises(InputError, match='size of the images'):
        watching.show(watch.Shot(np.zeros((64, 64, 3), np.uint8), 2 * NS_PER_S))


def test_the_command_records_what_it_saw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, 'load_detector', lambda _: load_detector(save_detector(tmp_path / 'detector.onnx')))
    video = write_video(tmp_path / 'me.mp4', [draw([p]) for p in walk(20)], [i / 10 for i in range(20)])
    assert main(['view', '--live', str(video), '--port', '0', '-o', str(tmp_path / 'me.mcap')]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('http://127.0.0.1:')
    assert lines[1].startswith(f'{tmp_path / "me.mcap"}: ')
    (sequence,), _ = load_people(tmp_path / 'me.mcap', ReadingOptions(), only_one=True)
    assert len(sequence) >= 8


def test_a_video_begins_when_a_browser_looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, 'load_detector', lambda _: load_detector(save_detector(tmp_path / 'detector.onnx')))
    video = write_video(tmp_path / 'me.mp4', [draw([p]) for p in walk(10)], [i / 10 for i in range(10)])
    looked: list[bool] = []
    show, enter = watch.Watch.show, PageServer.__enter__

    def note_whether_somebody_looks(watching: watch.Watch, shot: watch.Shot, *given: Any) -> None:
        looked.append(watching._scene.is_viewed)
        show(watching, shot, *given)

    def look_later(server: PageServer) -> PageServer:
        threading.Timer(0.5, server.scene.wait, [-1]).start()
        return enter(server)

    monkeypatch.setattr(watch.Watch, 'show', note_whether_somebody_looks)
    monkeypatch.setattr(PageServer, '__enter__', look_later)
    assert main(['view', '--live', str(video), '--port', '0']) == 0
    assert looked[0]


def test_what_a_camera_gave_before_it_broke_off_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, 'load_detector', lambda _: load_detector(save_detector(tmp_path / 'detector.onnx')))
    images = [draw([p]) for p in walk(12)]
    last = np.zeros((64, 64, 3), np.uint8)  # of another size
    video = write_video(tmp_path / 'me.mp4', images, [i / 10 for i in range(12)])
    read = VideoReader.__iter__

    def break_off(reader: Any) -> Iterator[VideoImage]:
        yield from read(reader)
        yield VideoImage(last, 1.3)

    monkeypatch.setattr(VideoReader, '__iter__', break_off)
    assert main(['view', '--live', str(video), '--port', '0', '-o', str(tmp_path / 'me.mcap')]) == 1
    assert 'size of the images' in capsys.readouterr().err
    assert load_people(tmp_path / 'me.mcap', ReadingOptions(), only_one=True)[0]


def test_a_delayed_skeleton_is_on_its_own_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, published = LiveScene('camera'), []
    config = with_values(Config(), {'tracker.lag': 0.2})
    detector = load_detector(save_detector(tmp_path / 'detector.onnx'))
    watching = watch.Watch(detector, load_base_pose_models('auto'), config, scene)
    scene.wait(-1)
    monkeypatch.setattr(scene, 'publish', lambda *given: published.append(given))
    people = walk(12)
    for frame, person in enumerate(people):
        watching.show(watch.Shot(draw([person]), NS_PER_S + round(frame * NS_PER_S / 30)))
    stamp_ns, *_, jpeg = published[-1]
    shown = round((stamp_ns - NS_PER_S) / NS_PER_S * 30)
    assert shown < 11
    assert jpeg == encode_jpeg(draw([people[shown]]))


@pytest.mark.parametrize(
    ('arguments', 'place'),
    [(['--fps', '30'], '--fps'), (['--strict'], '--strict'), (['-o', 'me.html'], 'me.html')],
)
def test_options_that_do_not_apply_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], place: str
) -> None:
    (tmp_path / 'me.mp4').write_bytes(b'no video')
    assert main(['view', '--live', str(tmp_path / 'me.mp4'), *arguments]) == 1
    assert place in capsys.readouterr().err


def test_what_is_shown_live(tmp_path: Path) -> None:
    (tmp_path / 'me.mp4').touch()
    assert view.find_live_source(str(tmp_path / 'me.mp4')) == tmp_path / 'me.mp4'
    assert view.find_live_source('rtsp://camera.example/1') == 'rtsp://camera.example/1'
    assert view.find_live_source('/dev/video91') == Path('/dev/video91')
    assert view.find_live_source('/left') is view.find_live_source('') is None
