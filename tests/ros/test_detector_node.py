# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`detector_node` as its users run it: images in over DDS, keypoints out, and on to `mocap_node`."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.messages.cdr import decode
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.ros.main import detector_main as main
from mocap_ros.ros.message_types import load_interface_class
from tests.support.blob_people import draw, save_movenet, walk
from tests.support.image_messages import encode_pixels, make_compressed
from tests.support.ros_node import TIMEOUT_S, Peer, Process, StartNode, stop_node, wait_until_discovered

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros

FRAME_NS = 33_333_333
# The detector takes the newest image only, if nothing else is said.
TAKE_ALL_IMAGES = (
    'qos_overrides./image.subscription.reliability:=reliable',
    'qos_overrides./image.subscription.depth:=10',
)
DETECTOR = sys.executable, '-c', 'import sys; from mocap_ros.ros import main; sys.exit(main.detector_main())'
StartDetector = Callable[..., Process]


@pytest.fixture
def start_detector(env: dict[str, str], tmp_path: Path) -> Iterator[StartDetector]:
    """Start `detector_node` with a network that finds people made of blobs, and further parameters."""
    model = save_movenet(tmp_path / 'movenet.onnx')
    started: list[Process] = []

    def start(*parameters: str) -> Process:
        options = [word for p in (f'model:={model}', *TAKE_ALL_IMAGES, *parameters) for word in ('-p', p)]
        command = [*DETECTOR, '--ros-args', *options]
        started.append(subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


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


def stop(process: Process) -> list[str]:
    """Stop the node; return the warnings and errors that it logged."""
    process.send_signal(signal.SIGTERM)
    _, log = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0
    return [line for line in log.splitlines() if not line.startswith('[INFO]')]


def test_images_of_several_encodings_become_skeletons(
    peer: Peer, start_detector: StartDetector, start_node: StartNode
) -> None:
    node, detector = start_node(), start_detector()
    peer.wait_for_node()
    camera = Camera(peer)
    nobody, first_stamps_ns = encode_pixels(draw([]), 'mono8'), count(10**9, FRAME_NS)
    # Until the nodes have discovered each other.
    peer.wait_until(lambda: camera.show(next(first_stamps_ns), **nobody) and peer.received['skeletons'])
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
    assert len(camera.show(2 * 10**12, **nobody).people) == 0
    assert stop(detector) == []
    stop_node(node)


def test_compressed_images_are_taken(peer: Peer, start_detector: StartDetector) -> None:
    detector = start_detector(f'image_type:={COMPRESSED_IMAGE}')
    camera = Camera(peer, COMPRESSED_IMAGE)
    for stamp_ns, kind in enumerate(['PNG', 'JPEG'], 1):
        (found,) = camera.show(stamp_ns, **make_compressed(draw([walk(1)[0]]), kind)).people
        assert max(found.score) > 0.5
    assert stop(detector) == []


def test_bad_images_are_logged_and_the_next_one_is_taken(peer: Peer, start_detector: StartDetector) -> None:
    detector = start_detector()
    camera = Camera(peer)
    good = encode_pixels(draw([walk(1)[0]]), 'rgb8')
    for number in (1, 2):
        camera.send(10**9 + number, **{**good, 'encoding': 'mono2'})
    camera.send(10**9 + 3, **{**good, 'step': 3})
    assert len(camera.show(2 * 10**9, **good).people) == 1
    camera.send(2 * 10**9, **good)
    assert len(camera.show(10**9, **good).people) == 1  # a bag that is played again
    lines = stop(detector)
    for words in (
        "/image: message 1: encoding: 'mono2', expected one of rgb8",
        '/image: message 3: step: 3 bytes, less than a row of 640 pixels in rgb8',
        '/image: message 5: header.stamp: that of the image before',
        'the stamps of the images go back; the detector starts anew',
    ):
        assert sum(words in line for line in lines) == 1, (words, lines)
    assert len(lines) == 4


@pytest.mark.parametrize(
    ('arguments', 'code', 'reason'),
    [
        (['-p', 'model:=none.onnx'], 1, 'none.onnx: no such file; expected MediaPipe'),
        (['-p', 'image_type:=std_msgs/msg/String'], 1, "image_type = 'std_msgs/msg/String': expected"),
    ],
)
def test_what_keeps_the_node_from_starting_is_named_in_one_line(
    env: dict[str, str], tmp_path: Path, arguments: list[str], code: int, reason: str
) -> None:
    command = [*DETECTOR, '--ros-args', *arguments]
    done = subprocess.run(command, env=env, cwd=tmp_path, capture_output=True, text=True, check=False)
    (line,) = done.stderr.splitlines()
    assert done.returncode == code
    assert line.startswith('detector_node: ')
    assert reason in line


def test_help_lists_parameters_and_topics(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(['--help'])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    for word in ('model:=', 'max_people:=1', 'image_type:=', IMAGE, COMPRESSED_IMAGE, KEYPOINTS):
        assert word in text
