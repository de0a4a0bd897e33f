# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints are loaded from bags, and a bag is refused where a sequence file is expected."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

import mocap_ros
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.runtime.load_keypoints import InputOptions, load_input
from mocap_ros.units import NS_PER_S
from tests.support.camera_infos import camera_info
from tests.support.keypoint_files import FPS, FRAMES, LIMITS, make_walker

START_NS = 1_760_000_000_000_000_000
Image = tuple[int, str, tuple[int, int], int]  # stamp in ns, camera, size in px, and the frame of the walk


def make_images() -> list[Image]:
    return [(START_NS + f * NS_PER_S // 25, 'cam', (640, 480), f) for f in range(FRAMES)]


def write_bag(folder: Path, images: Iterable[Image], infos: Mapping[str, bytes] = MappingProxyType({})) -> Path:
    """Write a bag of the walk of anna."""
    with Recorder(folder, RecorderConfig(min_free_mb=0)) as recorder:
        for topic, raw in infos.items():
            recorder.write(topic, CAMERA_INFO, raw, START_NS, START_NS)
        for number, (stamp, camera, size, frame) in enumerate(images):
            data = encode_keypoints(Header(stamp, camera), size, [make_walker().person(frame, 'anna')])
            recorder.write('/k', KEYPOINTS, data, START_NS + number, stamp)
    return folder


def test_a_bag_gives_the_keypoints_and_their_stamps(tmp_path: Path) -> None:
    sequence, (chosen,) = load_input(write_bag(tmp_path / 'bag', make_images()), InputOptions(Video(), LIMITS))
    assert sequence.stamps_ns == [stamp for stamp, *_ in make_images()]
    assert (sequence.person_id, sequence.frame_id, sequence.image_size) == ('anna', 'cam', (640, 480))
    assert sequence.keypoints == pytest.approx(make_walker().keypoints, nan_ok=True, abs=1e-3)
    assert "'anna', seen in 40 of 40 frames" in chosen
    with pytest.raises(InputError, match="bag: no person 'bob'; there are anna"):
        load_input(tmp_path / 'bag', InputOptions(Video(), LIMITS, person='bob'))


def add_other_camera(images: list[Image]) -> list[Image]:
    """Add another camera with the same stamps: the images of the two would alternate in one sequence."""
    others = [(image[0], 'right', image[2], FRAMES - 1 - image[3]) for image in images]
    pairs = enumerate(zip(images, others, strict=True))
    return [image for number, pair in pairs for image in pair[:: -1 if number % 2 else 1]]


@pytest.mark.parametrize(
    ('edit', 'has_info', 'line'),
    [
        (lambda i: [(0, *i[0][1:]), *i[1:]], False, '1 messages left out; /k: header.stamp '),
        (lambda i: [i[0], *i], False, '1 messages left out; /k: message 2: its stamp '),
        (
            lambda i: [*i[:-10], *((*m[:2], (320, 240), m[3]) for m in i[-10:])],
            False,
            '10 messages left out; /k: ',
        ),
        (lambda i: [(*i[0][:2], (1280, 960), 0), *i[1:]], True, '/k: message 1: image_width, image_height: '),
        (add_other_camera, False, "40 messages left out; /k: message 2: header.frame_id: 'right', but the images"),
    ],
)
def test_messages_that_do_not_belong_are_left_out(
    tmp_path: Path, edit: Callable[[list[Image]], list[Image]], has_info: bool, line: str
) -> None:
    bag = write_bag(tmp_path / 'bag', edit(make_images()), {'/camera_info': camera_info()} if has_info else {})
    sequence, lines = load_input(bag, InputOptions(Video(), LIMITS))
    first = round((sequence.stamps_ns[0] - START_NS) * 25 / NS_PER_S)
    walk = make_walker().keypoints[first : first + len(sequence)]
    assert sequence.keypoints == pytest.approx(walk, nan_ok=True, abs=1e-3)
    assert line in lines[1]


def test_a_transposed_image_size_is_refused_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    walker = make_walker()
    keypoints = np.nan_to_num(walker.keypoints + [600.0, 0.0, 0.0])
    people = [{'image_id': f, 'keypoints': k.ravel().tolist(), 'score': 1.0} for f, k in enumerate(keypoints)]
    path = tmp_path / 'walk.json'
    path.write_text(json.dumps(people))

    def load(size: tuple[int, int]) -> list[str]:
        return load_input(path, InputOptions(Video(fps=FPS, image_size=size), LIMITS))[1]

    with pytest.raises(InputError, match=r'walk\.json: --image-size: .* but inside 1100 x 480 px'):
        load((480, 1100))
    assert len(load((1100, 480))) == 1
    _, warning = load((320, 240))
    assert re.search(r'walk\.json: image size: .* lie outside 320 x 240 px', warning)


def test_a_focal_length_is_given_where_none_is_known(tmp_path: Path) -> None:
    save_sequence(tmp_path / 'a.npz', make_walker())  # 640 px wide
    assert not load_input(tmp_path / 'a.npz', InputOptions(Video(), LIMITS))[0].is_camera_known
    for video, focal in ((Video(hfov=90.0), 320), (Video(focal=500.0), 500)):
        known, lines = load_input(tmp_path / 'a.npz', InputOptions(video, LIMITS))
        camera = known.intrinsics(1.0)
        assert camera.focal == pytest.approx(focal)
        assert (camera.center, camera.is_focal_known) == ((320, 240), True)
        assert not lines
    with pytest.raises(InputError, match=r'a\.npz: --focal: 26 px in an image 640 px wide are 171 degrees'):
        load_input(tmp_path / 'a.npz', InputOptions(Video(focal=26.0), LIMITS))
    flat = make_walker().keypoints.reshape(FRAMES, -1)
    people = [{'image_id': f, 'keypoints': np.nan_to_num(k).tolist(), 'score': 1.0} for f, k in enumerate(flat)]
    (tmp_path / 'c.json').write_text(json.dumps(people))
    with pytest.raises(InputError, match=r'c\.json: --hfov and --focal need --image-size'):
        load_input(tmp_path / 'c.json', InputOptions(Video(fps=FPS, hfov=60.0), LIMITS))
    save_sequence(tmp_path / 'b.npz', known)
    calibrated, (line,) = load_input(tmp_path / 'b.npz', InputOptions(Video(hfov=90.0), LIMITS))
    assert calibrated.intrinsics(1.0).focal == pytest.approx(500)
    assert '--hfov and --focal are not used' in line
    assert mocap_ros.read(tmp_path / 'a.npz', hfov=90.0).intrinsics(1.0).focal == pytest.approx(320)
    with pytest.raises(mocap_ros.InputError, match='hfov: 200'):
        mocap_ros.read(tmp_path / 'a.npz', hfov=200.0)


@pytest.mark.parametrize('usable', [False, True])
def test_a_camera_info_that_cannot_be_used_is_named(tmp_path: Path, *, usable: bool) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for number, first in enumerate([math.nan, 0.1 if usable else 1e7], 1):
            raw = camera_info(d=(first, 0.0, 0.0, 0.0, 0.0))
            recorder.write('/cam/camera_info', CAMERA_INFO, raw, number, number)
        for frame, stamp in enumerate(make_walker().stamps_ns, 1):
            raw = encode_keypoints(Header(stamp, 'camera'), (640, 480), [make_walker().person(frame - 1)])
            recorder.write('/cam/keypoints', KEYPOINTS, raw, frame, frame)
    sequence, lines = load_input(tmp_path / 'bag', InputOptions(Video(), LIMITS))
    assert any(
        line.endswith('/cam/camera_info: message 1: distortion: a coefficient is not finite; it is not used')
        for line in lines
    )
    assert sequence.calibration is not None
    assert bool(sequence.calibration.distortion.coefficients) == usable


def test_of_several_cameras_of_a_bag_one_is_chosen(tmp_path: Path) -> None:
    infos = {f'/{side}/camera_info': camera_info(focal=f) for side, f in (('left', 500.0), ('right', 600.0))}
    bag = write_bag(tmp_path / 'bag', make_images(), infos)
    with pytest.raises(InputError, match='choose one with --camera-info: /left/camera_info, /right/camera_info'):
        load_input(bag, InputOptions(Video(), LIMITS))
    sequence, _ = load_input(bag, InputOptions(Video(), LIMITS, camera_info='/right/camera_info'))
    assert sequence.intrinsics(1.0).focal == pytest.approx(600)
    assert mocap_ros.read(bag, camera_info='/left/camera_info').intrinsics(1.0).focal == pytest.approx(500)
    with pytest.raises(InputError, match='there is no CameraInfo on /back'):
        load_input(bag, InputOptions(Video(), LIMITS, camera_info='/back'))
    with pytest.raises(mocap_ros.InputError, match='choose one with camera_info: '):
        mocap_ros.read(bag)
