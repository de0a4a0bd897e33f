# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The programs as users start them: help, wrong arguments, interrupts, and `detector_node` on images."""

import subprocess
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.config import Config, to_yaml
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.ros.main import detector_main, main
from mocap_ros.ros.message_types import load_interface_class
from tests.support.blob_people import draw, save_movenet, walk
from tests.support.image_messages import encode_pixels, make_compressed
from tests.support.ros_node import Peer, Process, StartNode, StartProgram, stop_node, wait_until_discovered

pytestmark = pytest.mark.ros

FRAME_NS = 33_333_333
# The detector takes the newest image only, if nothing else is said.
TAKE_ALL_IMAGES = (
    'qos_overrides./image.subscription.reliability:=reliable',
    'qos_overrides./image.subscription.depth:=10',
)
DETECTOR = sys.executable, '-c', 'import sys; from mocap_ros.ros import main; sys.exit(main.detector_main())'


@pytest.mark.parametrize(
    ('program', 'arguments', 'code', 'reason'),
    [
        (main, ['--ros-args', '--params-file', 'bad.yaml'], 1, 'bad.yaml'),
        (main, ['--ros-args', '--frobnicate'], 1, '--frobnicate'),
        (main, ['--ros-args', '-r', '__ns:=/left', '--params-file', 'p.yaml'], 1, 'tracker.body_height'),
        (main, ['tracker.window:=2.0'], 2, 'tracker.window:=2.0'),
        (detector_main, ['--ros-args', '-p', 'model:=none.onnx'], 1, 'none.onnx'),
        (detector_main, ['--ros-args', '-p', 'image_type:=std_msgs/msg/String'], 1, 'image_type'),
    ],
)
def test_wrong_arguments_are_reported_in_one_line(
    env: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    program: Callable[..., int],
    arguments: list[str],
    code: int,
    reason: str,
) -> None:
    assert env['ROS_DOMAIN_ID']
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('mocap_ros.ros.nodes.signal.signal', lambda *_: None)  # the handlers of pytest stay
    (tmp_path / 'bad.yaml').write_text('{')
    wrong = to_yaml(Config()).replace('body_height: 1.7\n', 'body_height: 9.0\n')
    (tmp_path / 'p.yaml').write_text(wrong)
    try:
        found = program(arguments)
    except SystemExit as stopped:
        found = int(stopped.code or 0)
    *usage, line = capfd.readouterr().err.splitlines()
    assert (found, len(usage)) == (code, code - 1)
    assert line.startswith(('mocap_node: ', 'detector_node: '))
    assert reason in line


def test_a_missing_ros_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name in [name for name in sys.modules if name.startswith('mocap_ros.ros.')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main([]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('mocap_node: needs ROS 2')


@pytest.mark.parametrize(
    ('program', 'end'),
    [('mocap_ros.ros.main', (0, '')), ('mocap_ros.cli.main', (130, 'mocap-ros: interrupted\n'))],
)
def test_an_interrupted_start_gives_no_traceback(env: dict[str, str], program: str, end: tuple[int, str]) -> None:
    code = (
        'import _thread, builtins, sys; real = builtins.__import__\n'
        'def slow(name, *rest):\n'
        "    if name.startswith('mocap_ros.messages'): _thread.interrupt_main()\n"
        '    return real(name, *rest)\n'
        f'from {program} import main\n'
        "builtins.__import__ = slow; sys.exit(main(['replay', 'x', '-o', 'y']))"
    )
    done = subprocess.run([sys.executable, '-c', code], env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == end


@pytest.fixture
def start_detector(start: StartProgram, tmp_path: Path) -> Callable[..., Process]:
    """Start `detector_node` with a network that finds people made of blobs, and further parameters."""
    model = save_movenet(tmp_path / 'movenet.onnx')

    def start_with(*parameters: str) -> Process:
        options = [word for p in (f'model:={model}', *TAKE_ALL_IMAGES, *parameters) for word in ('-p', p)]
        return start(*DETECTOR, '--ros-args', *options)

    return start_with


class Camera:
    """Publisher of images, which waits for the keypoints of each."""

    def __init__(self, peer: Peer, msgtype: str = IMAGE) -> None:
        self.peer = peer
        self.received: list[Any] = []
        self.message_class = load_interface_class(msgtype)
        peer.node.create_subscription(
            load_interface_class(KEYPOINTS), 'keypoints', lambda raw: self.received.append(decode(raw, KEYPOINTS)),
            10, raw=True,
        )  # fmt: skip
        self.publisher = peer.node.create_publisher(self.message_class, 'image', 10)
        peer.wait_until(self.publisher.get_subscription_count)
        wait_until_discovered(peer.node, peer.executor, 'detector_node')

    def send(self, stamp_ns: int, **fields: Any) -> None:
        message = self.message_class(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        message.header.frame_id = 'optical'
        self.publisher.publish(message)

    def show(self, stamp_ns: int, **fields: Any) -> Any:
        """Return the keypoints of the next image."""
        before = len(self.received)
        self.send(stamp_ns, **fields)
        self.peer.wait_until(lambda: len(self.received) > before)
        return self.received[-1]


def test_images_of_several_encodings_become_skeletons_and_bad_ones_are_logged(
    peer: Peer, start_detector: Callable[..., Process], start_node: StartNode
) -> None:
    node, detector = start_node(), start_detector()
    peer.wait_for_node()
    camera = Camera(peer)
    empty, first_stamps_ns = encode_pixels(draw([]), 'mono8'), count(10**9, FRAME_NS)
    # Until the nodes have discovered each other.
    peer.wait_until(lambda: camera.show(next(first_stamps_ns), **empty) and peer.received['skeletons'])
    people = walk(6)
    encodings = ['rgb8', 'bgra8', 'yuv422_yuy2', 'bgr8', 'uyvy', 'bayer_rggb8']
    stamps_ns = [10**12 + frame * FRAME_NS for frame in range(6)]
    for stamp_ns, person, encoding in zip(stamps_ns, people, encodings, strict=True):
        message = camera.show(stamp_ns, **encode_pixels(draw([person]), encoding, padding=7))
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(stamp_ns, 10**9)
        assert message.header.frame_id == 'optical'
        assert (message.image_width, message.image_height) == (640, 480)
        (found,) = message.people
        assert found.skeleton == 'coco17'
        seen = np.array(found.score) > 0.5
        errors = np.hypot(np.array(found.x) - person[:, 0], np.array(found.y) - person[:, 1])[seen]
        assert np.nanmedian(errors) < 1.5, encoding
    peer.wait_until(lambda: set(stamps_ns) <= set(peer.received_stamps('skeletons')))
    (skeleton,) = decode(peer.received['skeletons'][-1], SKELETONS).people
    assert len(skeleton.joints) == 26
    stop_node(node)
    assert len(camera.show(2 * 10**12, **empty).people) == 0
    good = encode_pixels(draw([people[0]]), 'rgb8')
    for number, fault in enumerate([{'encoding': 'mono2'}] * 2 + [{'step': 3}]):
        camera.send(2 * 10**12 + number, **{**good, **fault})
    assert len(camera.show(3 * 10**12, **good).people) == 1
    camera.send(3 * 10**12, **good)
    assert len(camera.show(10**9, **good).people) == 1  # a bag that is played again
    lines = stop_node(detector)
    places = ': encoding: ', ': step: ', ': header.stamp: ', 'the detector starts anew'
    assert [[place in line for line in lines].count(True) for place in places] == [1] * len(lines) == [1] * 4


def test_compressed_images_are_taken(peer: Peer, start_detector: Callable[..., Process]) -> None:
    detector = start_detector(f'image_type:={COMPRESSED_IMAGE}')
    camera = Camera(peer, COMPRESSED_IMAGE)
    for stamp_ns, kind in enumerate(['PNG', 'JPEG'], 1):
        (found,) = camera.show(stamp_ns, **make_compressed(draw([walk(1)[0]]), kind)).people
        assert max(found.score) > 0.5
    assert stop_node(detector) == []
