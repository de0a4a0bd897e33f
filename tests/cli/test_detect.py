# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command `detect`, and `reconstruct` of a video."""

import itertools
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.api.evaluate import evaluate
from mocap_ros.bags.reader import Bag
from mocap_ros.cli.main import main
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import GroundTruth, load_sequence
from mocap_ros.formats.video import VideoImage, VideoReader
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime import detection
from mocap_ros.skeleton import CMU15
from tests.support.blob_people import draw, save_movenet, save_multi_pose_movenet, walk, write_video

FRAMES = 40
FPS = 30.0  # Hz, that of the demo


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of a walker with four empty images at its beginning, and a network that finds the walker."""
    path = tmp_path_factory.mktemp('video')
    images = [draw([])] * 4 + [draw([person]) for person in walk(FRAMES)]
    write_video(path / 'walk.mp4', images, [i / FPS for i in range(len(images))], 'libx264', 'yuv420p')
    save_movenet(path / 'movenet.onnx')
    return path


def test_a_video_becomes_a_skeleton(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ['reconstruct', str(folder / 'walk.mp4'), '--detector', str(folder / 'movenet.onnx')]
    assert main([*command, '-o', str(tmp_path / 'out.npz')]) == 0
    assert '1 person in 40 frames' in capsys.readouterr().out
    result = np.load(tmp_path / 'out.npz')
    assert result['timestamps'] == pytest.approx(np.arange(4, FRAMES + 4) / FPS, abs=1e-3)
    errors = evaluate(result['joints3d'].astype(float), GroundTruth(make_recording().truth[:FRAMES], CMU15.joints))
    assert errors.pa_mpjpe_mm is not None
    assert errors.pa_mpjpe_mm < 30.0, 'measured: 22.1'
    assert main([*command, '-o', str(tmp_path / 'out.bvh')]) == 0
    assert 'Frames: 40' in (tmp_path / 'out.bvh').read_text()


def test_detect_writes_the_keypoints_of_one_person_or_a_bag_of_all(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ['detect', str(folder / 'walk.mp4'), '--model', str(folder / 'movenet.onnx')]
    assert main(command) == 0
    assert capsys.readouterr().out == 'walk_2d.npz: 17 keypoints of person_1, 40 frames in 1.3 s\n'
    assert len(load_sequence('walk_2d.npz')) == FRAMES
    assert main([*command, '--duration', '0.5', '-o', 'short.npz']) == 0
    assert len(load_sequence('short.npz')) == 11

    people = walk(6)
    images = [draw([person - [150.0, 0.0], person + [150.0, 0.0]]) for person in people]
    write_video(tmp_path / 'two.mkv', images, [i / FPS for i in range(6)])
    save_multi_pose_movenet(tmp_path / 'multi.onnx')
    command = ['detect', 'two.mkv', '--model', 'multi.onnx', '--max-people', '2', '-o', 'two.mcap']
    assert main(command) == 0
    assert capsys.readouterr().out.endswith('two.mcap: 2 people, 6 frames in 0.2 s\n')
    with Bag(tmp_path / 'two.mcap') as bag:
        messages = [decode(message.raw, KEYPOINTS) for message in bag.messages(['/keypoints'])]
    assert [[person.id for person in message.people] for message in messages] == [['person_1', 'person_2']] * 6
    assert {(m.image_width, m.image_height) for m in messages} == {(640, 480)}


def test_an_interrupt_keeps_the_detected(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class InterruptedCamera(VideoReader):
        """A video instead of a camera."""

        def __init__(self, path: Path, *, is_camera: bool) -> None:
            assert is_camera
            super().__init__(path)

        def __iter__(self) -> Iterator[VideoImage]:
            yield from itertools.islice(super().__iter__(), 20)
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(2.0)  # in which the command has ended, however busy the machine is
            yield from super().__iter__()

    monkeypatch.setattr(detection, 'VideoReader', InterruptedCamera)
    monkeypatch.setattr('mocap_ros.cli.detect.find_camera', Path)
    out = tmp_path / 'me.npz'
    command = ['detect', str(folder / 'walk.mp4'), '--model', str(folder / 'movenet.onnx'), '-o', str(out)]
    assert main(command) == 0
    assert 0 < len(load_sequence(out)) <= 20 - 4


@pytest.mark.parametrize(
    ('options', 'reason'),
    [
        (['-o', 'a.bvh'], 'a.bvh: unknown file type'),
        (['-o', 'a.mcap', '--person', 'x'], 'a.mcap: holds all people'),
    ],
)
def test_wrong_outputs_are_named_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], reason: str
) -> None:
    assert main(['detect', str(folder / 'walk.mp4'), *options]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
