# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints are loaded from bags, and a bag is refused where a sequence file is expected."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocap_ros
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.formats import detections
from mocap_ros.formats.detections import Detections, PersonTrack, Video, associate_people
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.runtime import load_keypoints
from mocap_ros.runtime.load_keypoints import load_input, load_people, load_sequence_file
from mocap_ros.units import NS_PER_S
from tests.support.camera_infos import camera_info
from tests.support.keypoint_files import FPS, FRAMES, LIMITS, make_walker


def test_a_bag_gives_the_keypoints_and_their_stamps(tmp_path: Path) -> None:
    walker = make_walker()
    start = 1_760_000_000_123_456_789
    stamps = [start + f * NS_PER_S // 25 for f in range(FRAMES)]
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame, stamp in enumerate(stamps):
            data = encode_keypoints(Header(stamp, 'cam'), (640, 480), [walker.person(frame, 'anna')])
            recorder.write('/k', KEYPOINTS, data, stamp, stamp)
        recorder.write('/k', KEYPOINTS, b'\0\1\0\0', stamps[-1] + 1, stamps[-1] + 1)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert sequence.stamps_ns == stamps
    assert (sequence.person_id, sequence.frame_id, sequence.image_size) == ('anna', 'cam', (640, 480))
    assert sequence.keypoints == pytest.approx(walker.keypoints, nan_ok=True, abs=1e-3)
    assert "'anna', seen in 40 of 40 frames" in lines[0]
    assert '1 messages left out; /k: message 41' in lines[1]
    with pytest.raises(InputError, match="bag: no person 'bob'; there are anna"):
        load_input(tmp_path / 'bag', Video(), LIMITS, person='bob')


def test_a_message_whose_stamp_was_not_set_is_left_out_of_a_bag_with_clock_stamps(tmp_path: Path) -> None:
    walker = make_walker()
    start = 1_760_000_000_000_000_000
    stamps = [0, *(start + f * NS_PER_S // 25 for f in range(1, FRAMES))]
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame, stamp in enumerate(stamps):
            data = encode_keypoints(Header(stamp, 'cam'), (640, 480), [walker.person(frame, 'anna')])
            recorder.write('/k', KEYPOINTS, data, start + frame, stamp)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert sequence.stamps_ns == stamps[1:]
    assert '1 messages left out; /k: header.stamp is not set' in lines[1]


def test_images_of_another_size_are_left_out(tmp_path: Path) -> None:
    """The camera was switched to half the resolution, in whose px no other keypoints are."""
    walker = make_walker()
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame in range(FRAMES):
            stamp, size = NS_PER_S + frame * NS_PER_S // 25, (640, 480) if frame < FRAMES - 10 else (320, 240)
            data = encode_keypoints(Header(stamp, 'cam'), size, [walker.person(frame, 'anna')])
            recorder.write('/k', KEYPOINTS, data, stamp, stamp)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert (sequence.image_size, len(sequence)) == ((640, 480), FRAMES - 10)
    assert '10 messages left out; /k: 10 images have another size than the others' in lines[1]


def test_images_of_another_size_than_that_of_camera_info_are_left_out(tmp_path: Path) -> None:
    walker = make_walker()
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), 0, 0)
        for frame in range(FRAMES):
            size = (1280, 960) if frame == 0 else (640, 480)
            data = encode_keypoints(Header((frame + 1) * NS_PER_S // 25, 'camera'), size, [walker.person(frame)])
            recorder.write('/keypoints', KEYPOINTS, data, frame, frame)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert (len(sequence), sequence.image_size) == (FRAMES - 1, (640, 480))
    assert any('1280 x 960 px, but CameraInfo is for 640 x 480 px' in line for line in lines)


def test_a_bag_is_refused_where_a_sequence_file_is_expected(tmp_path: Path) -> None:
    for bag in (tmp_path / 'bag', tmp_path / 'bag.mcap', tmp_path / 'bag.npz'):
        bag.mkdir()
        (bag / 'bag_0.db3').touch()
        with pytest.raises(InputError, match=f'{bag.name}: is a bag; expected a sequence file'):
            load_sequence_file(bag)


def test_a_transposed_image_size_is_refused_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    walker = make_walker()
    keypoints = np.nan_to_num(walker.keypoints + [600.0, 0.0, 0.0])
    people = [{'image_id': f, 'keypoints': k.ravel().tolist(), 'score': 1.0} for f, k in enumerate(keypoints)]
    path = tmp_path / 'walk.json'
    path.write_text(json.dumps(people))

    def load(size: tuple[int, int]) -> list[str]:
        return load_input(path, Video(fps=FPS, image_size=size), LIMITS)[1]

    transposed = (
        r'walk\.json: --image-size: \d+% of the seen keypoints lie outside 480 x 1100 px, '
        'but inside 1100 x 480 px: width and height look transposed$'
    )
    with pytest.raises(InputError, match=transposed):
        load((480, 1100))
    assert len(load((1100, 480))) == 1
    _, warning = load((320, 240))
    assert re.fullmatch(r'.*walk\.json: image size: \d+% of the seen keypoints lie outside 320 x 240 px', warning)


def test_a_focal_length_is_given_where_none_is_known(tmp_path: Path) -> None:
    save_sequence(tmp_path / 'a.npz', make_walker())  # 640 px wide
    assert not load_input(tmp_path / 'a.npz', Video(), LIMITS)[0].is_camera_known
    for video, focal in ((Video(hfov=90.0), 320), (Video(focal=500.0), 500)):
        known, lines = load_input(tmp_path / 'a.npz', video, LIMITS)
        camera = known.intrinsics(1.0)
        assert camera.focal == pytest.approx(focal)
        assert (camera.center, camera.is_focal_known) == ((320, 240), True)
        assert not lines
    with pytest.raises(InputError, match=r'a\.npz: --focal: 26 px in an image 640 px wide are 171 degrees'):
        load_input(tmp_path / 'a.npz', Video(focal=26.0), LIMITS)
    flat = make_walker().keypoints.reshape(FRAMES, -1)
    people = [{'image_id': f, 'keypoints': np.nan_to_num(k).tolist(), 'score': 1.0} for f, k in enumerate(flat)]
    (tmp_path / 'c.json').write_text(json.dumps(people))
    with pytest.raises(InputError, match=r'c\.json: --hfov and --focal need --image-size'):
        load_input(tmp_path / 'c.json', Video(fps=FPS, hfov=60.0), LIMITS)
    save_sequence(tmp_path / 'b.npz', known)
    calibrated, (line,) = load_input(tmp_path / 'b.npz', Video(hfov=90.0), LIMITS)
    assert calibrated.intrinsics(1.0).focal == pytest.approx(500)
    assert '--hfov and --focal are not used' in line
    assert mocap_ros.read(tmp_path / 'a.npz', hfov=90.0).intrinsics(1.0).focal == pytest.approx(320)
    with pytest.raises(mocap_ros.InputError, match='hfov: 200'):
        mocap_ros.read(tmp_path / 'a.npz', hfov=200.0)


@pytest.mark.filterwarnings('error')
def test_a_distortion_that_cannot_be_undone_is_named(tmp_path: Path) -> None:
    matrix = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 240.0], [0.0, 0.0, 1.0]])
    sequence = replace(make_walker(), camera_matrix=matrix, distortion=np.array([-5.0, 3.0, 0.0, 0.0, -9.0]))
    save_sequence(tmp_path / 'walk.npz', sequence)
    _, (line,) = load_input(tmp_path / 'walk.npz', Video(), LIMITS)
    assert re.search(
        r'walk\.npz: distortion of the camera: it cannot be undone in \d+% of the middle of the image', line
    )


def test_images_of_another_camera_are_left_out(tmp_path: Path) -> None:
    """Two cameras on one topic, with the same stamps: their images would alternate in one sequence."""
    walker = make_walker()
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame in range(FRAMES):
            stamp = NS_PER_S + frame * NS_PER_S // 25
            for camera, shown in (('left', frame), ('right', FRAMES - 1 - frame))[:: 1 if frame % 2 == 0 else -1]:
                data = encode_keypoints(Header(stamp, camera), (640, 480), [walker.person(shown, 'anna')])
                recorder.write('/k', KEYPOINTS, data, stamp, stamp)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert sequence.keypoints == pytest.approx(walker.keypoints, nan_ok=True, abs=1e-3)
    assert f"{FRAMES} messages left out; /k: message 2: header.frame_id: 'right', but the images" in lines[1]


@pytest.mark.parametrize('usable', [False, True])
def test_a_camera_info_that_cannot_be_used_is_named(tmp_path: Path, *, usable: bool) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for number, first in enumerate([math.nan, 0.1 if usable else 1e7], 1):
            raw = camera_info(d=(first, 0.0, 0.0, 0.0, 0.0))
            recorder.write('/cam/camera_info', CAMERA_INFO, raw, number, number)
        for frame, stamp in enumerate(make_walker().stamps_ns, 1):
            raw = encode_keypoints(Header(stamp, 'camera'), (640, 480), [make_walker().person(frame - 1)])
            recorder.write('/cam/keypoints', KEYPOINTS, raw, frame, frame)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert any(
        line.endswith('/cam/camera_info: message 1 cannot be used: distortion: a coefficient is not finite')
        for line in lines
    )
    assert (sequence.calibration is not None) == usable


def test_of_several_cameras_of_a_bag_one_is_chosen(tmp_path: Path) -> None:
    walker = make_walker()
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for topic, focal in (('/left/camera_info', 500.0), ('/right/camera_info', 600.0)):
            recorder.write(topic, CAMERA_INFO, camera_info(focal=focal), NS_PER_S, NS_PER_S)
        for frame in range(FRAMES):
            stamp = NS_PER_S + frame * NS_PER_S // 25
            data = encode_keypoints(Header(stamp, 'cam'), (640, 480), [walker.person(frame, 'anna')])
            recorder.write('/k', KEYPOINTS, data, stamp, stamp)
    bag = tmp_path / 'bag'
    with pytest.raises(InputError, match='choose one with --camera-info: /left/camera_info, /right/camera_info'):
        load_input(bag, Video(), LIMITS)
    sequence, _ = load_input(bag, Video(), LIMITS, camera_info='/right/camera_info')
    assert sequence.intrinsics(1.0).focal == pytest.approx(600)
    assert mocap_ros.read(bag, camera_info='/left/camera_info').intrinsics(1.0).focal == pytest.approx(500)
    with pytest.raises(InputError, match='there is no CameraInfo on /back'):
        load_input(bag, Video(), LIMITS, camera_info='/back')
    with pytest.raises(mocap_ros.InputError, match='choose one with camera_info: '):
        mocap_ros.read(bag)


def test_people_without_ids_are_associated_once_however_many_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each association takes as long as the whole input has people, so one for each person would take hours."""
    walker = make_walker()
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame in range(FRAMES):
            stamp, person = (frame + 1) * NS_PER_S // 25, walker.person(frame)
            people = [replace(person, points=person.points + [x, 0]) for x in (0, 500, 1000)]
            recorder.write('/k', KEYPOINTS, encode_keypoints(Header(stamp, ''), (0, 0), people), stamp, stamp)
    calls = []

    def associate(found: Detections) -> list[PersonTrack]:
        calls.append(found)
        return associate_people(found)

    for module in (detections, load_keypoints):
        monkeypatch.setattr(module, 'associate_people', associate)
    sequences, lines = load_people(tmp_path / 'bag', Video(), LIMITS)
    assert [s.person_id for s in sequences] == ['person_1', 'person_2', 'person_3']
    assert len({s.image_size for s in sequences}) == len(calls) == 1
    assert [line for line in lines if 'image size not known' in line] == lines
