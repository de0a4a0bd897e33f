# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs: their kinds, what is loaded from bags and files, what their clocks did, and videos with their people;
the pipeline: bytes in, bytes out; bad input is counted and changes nothing."""

import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

import mocap_ros
from mocap_ros.arrays import Array
from mocap_ros.bags.journal import Acceptance
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.cli.main import main
from mocap_ros.config import NodeConfig, RecorderConfig, with_values
from mocap_ros.detectors.detector import Image
from mocap_ros.errors import InputError, ModelError
from mocap_ros.formats.detections import Detections, create_person, select_person
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.sequence_file import save_sequence, validate_sequence
from mocap_ros.formats.video import VideoImage
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, decode_keypoints, encode_keypoints
from mocap_ros.offline.whole_sequence import find_frames_in_sight
from mocap_ros.recordings import detect_people
from mocap_ros.recordings.detect_people import detect_in_video, name_people
from mocap_ros.recordings.input_kind import InputKind, check_options, find_input_kind, select_options
from mocap_ros.recordings.load_keypoints import load_input
from mocap_ros.runtime.frame_assembly import FrameAssembler
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import CORE_COUNT, keypoint_layout
from mocap_ros.units import NS_PER_S
from tests.support.blob_people import draw, save_detector, walk, write_video
from tests.support.camera_messages import camera_info
from tests.support.input_files import FPS, FRAMES, LIMITS, QUICK_OPTIONS, make_walker
from tests.support.pipeline_inputs import (
    FAST_CONFIG,
    decode_skeletons,
    encode_demo_frames,
    make_calibrated,
    process,
    reject,
    with_stamp,
)

COCO17, SIZE = keypoint_layout('coco17').joints, (640, 480)
START_NS = 1_760_000_000_000_000_000
Shot = tuple[int, str, tuple[int, int], int]  # stamp in ns, camera, size in px, and the frame of the walk


def make_images() -> list[Shot]:
    return [(START_NS + f * NS_PER_S // 25, 'cam', (640, 480), f) for f in range(FRAMES)]


def encode_image(image: Shot) -> bytes:
    stamp, camera, size, frame = image
    return encode_keypoints(Header(stamp, camera), size, [make_walker().person(frame, 'anna')])


def write_bag(folder: Path, images: Iterable[Shot], infos: Mapping[str, bytes] = MappingProxyType({})) -> Path:
    with Recorder(folder, RecorderConfig(min_free_mb=0)) as recorder:
        for topic, raw in infos.items():
            recorder.write(topic, CAMERA_INFO, raw, START_NS, START_NS)
        for number, image in enumerate(images):
            recorder.write('/k', KEYPOINTS, encode_image(image), START_NS + number, image[0])
    return folder


def add_other_camera(images: list[Shot]) -> list[Shot]:
    """Add another camera with the same stamps: the images of the two would alternate in one sequence."""
    others = [(image[0], 'right', image[2], FRAMES - 1 - image[3]) for image in images]
    pairs = enumerate(zip(images, others, strict=True))
    return [image for number, pair in pairs for image in pair[:: -1 if number % 2 else 1]]


@pytest.mark.parametrize(
    ('edit', 'has_info', 'line'),
    [
        (lambda i: [(0, *i[0][1:]), *i[1:]], False, '1 messages left out; /k: header.stamp '),
        (lambda i: [i[0], *i], False, '1 messages left out; /k: message 2: its stamp '),
        (lambda i: i[:-10] + [(*m[:2], (320, 240), m[3]) for m in i[-10:]], False, '10 messages left out; /k: '),
        (lambda i: [(*i[0][:2], (1280, 960), 0), *i[1:]], True, '/k: message 1: image_width, image_height: '),
        (add_other_camera, False, "40 messages left out; /k: message 2: header.frame_id: 'right', but the images"),
    ],
)
def test_messages_that_do_not_belong_are_left_out(
    tmp_path: Path, edit: Callable[[list[Shot]], list[Shot]], has_info: bool, line: str
) -> None:
    infos = {'/camera_info': camera_info(frame_id='cam')} if has_info else {}
    bag = write_bag(tmp_path / 'bag', edit(make_images()), infos)
    sequence, lines = load_input(bag, ReadingOptions(node=LIMITS))
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
        return load_input(path, ReadingOptions(fps=FPS, image_size=size, node=LIMITS))[1]

    with pytest.raises(InputError, match=r'walk\.json: --image-size: .* but inside 1100 x 480 px'):
        load((480, 1100))
    assert len(load((1100, 480))) == 1
    _, warning = load((320, 240))
    assert re.search(r'walk\.json: image size: .* lie outside 320 x 240 px', warning)


def test_a_focal_length_is_given_where_none_is_known(tmp_path: Path) -> None:
    save_sequence(tmp_path / 'a.npz', make_walker())  # 640 px wide
    assert not load_input(tmp_path / 'a.npz', ReadingOptions(node=LIMITS))[0].is_camera_known
    parameters = replace(LIMITS, hfov=90.0)
    for options, focal in (
        (ReadingOptions(hfov=90.0, node=LIMITS), 320),
        (ReadingOptions(node=parameters), 320),
        (ReadingOptions(focal=500.0, node=parameters), 500),
    ):
        known, lines = load_input(tmp_path / 'a.npz', options)
        camera = known.intrinsics(1.0)
        assert camera.focal == pytest.approx(focal)
        assert (camera.center, camera.is_focal_known) == ((320, 240), True)
        assert not lines
    with pytest.raises(InputError, match=r'a\.npz: --focal: 26 px in an image 640 px wide are 171 degrees'):
        load_input(tmp_path / 'a.npz', ReadingOptions(focal=26.0, node=LIMITS))
    flat = make_walker().keypoints.reshape(FRAMES, -1)
    people = [{'image_id': f, 'keypoints': np.nan_to_num(k).tolist(), 'score': 1.0} for f, k in enumerate(flat)]
    (tmp_path / 'c.json').write_text(json.dumps(people))
    with pytest.raises(InputError, match=r'c\.json: --hfov and --focal need --image-size'):
        load_input(tmp_path / 'c.json', ReadingOptions(fps=FPS, hfov=60.0, node=LIMITS))
    save_sequence(tmp_path / 'b.npz', known)
    calibrated, (line,) = load_input(tmp_path / 'b.npz', ReadingOptions(hfov=90.0, node=LIMITS))
    assert calibrated.intrinsics(1.0).focal == pytest.approx(500)
    assert '--hfov and --focal are not used' in line
    assert mocap_ros.read(tmp_path / 'a.npz', hfov=90.0).intrinsics(1.0).focal == pytest.approx(320)


@pytest.mark.parametrize('usable', [False, True])
def test_a_camera_info_that_cannot_be_used_is_named(tmp_path: Path, *, usable: bool) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for number, first in enumerate([math.nan, 0.1 if usable else 1e7], 1):
            raw = camera_info(d=(first, 0.0, 0.0, 0.0, 0.0))
            recorder.write('/cam/camera_info', CAMERA_INFO, raw, number, number)
        for frame, stamp in enumerate(make_walker().stamps_ns, 1):
            raw = encode_keypoints(Header(stamp, 'camera'), (640, 480), [make_walker().person(frame - 1)])
            recorder.write('/cam/keypoints', KEYPOINTS, raw, frame, frame)
    sequence, lines = load_input(tmp_path / 'bag', ReadingOptions(node=LIMITS))
    fault = '/cam/camera_info: message 1: distortion: a coefficient is not finite; it is not used'
    assert any(line.endswith(fault + '; instead, message 2 is used' * usable) for line in lines)
    assert sequence.calibration is not None
    assert bool(sequence.calibration.distortion.coefficients) == usable


def test_of_several_cameras_of_a_bag_one_is_chosen(tmp_path: Path) -> None:
    focals = {'left': 500.0, 'right': 600.0}
    infos = {f'/{side}/camera_info': camera_info(focal=f, frame_id='cam') for side, f in focals.items()}
    bag = write_bag(tmp_path / 'bag', make_images(), infos)
    with pytest.raises(InputError, match='choose one with --camera-info: /left/camera_info, /right/camera_info'):
        load_input(bag, ReadingOptions(node=LIMITS))
    sequence, _ = load_input(bag, ReadingOptions(node=LIMITS, camera_info='/right/camera_info'))
    assert sequence.intrinsics(1.0).focal == pytest.approx(600)
    assert mocap_ros.read(bag, camera_info='/left/camera_info').intrinsics(1.0).focal == pytest.approx(500)
    with pytest.raises(InputError, match='there is no CameraInfo on /back'):
        load_input(bag, ReadingOptions(node=LIMITS, camera_info='/back'))
    with pytest.raises(mocap_ros.InputError, match='choose one with camera_info: '):
        mocap_ros.read(bag)


COLOR, DEPTH = 'camera_color_optical_frame', 'camera_depth_optical_frame'


@pytest.mark.parametrize(
    ('images_of', 'infos_of', 'focal'),
    [
        (COLOR, {'/info': DEPTH}, None),
        (COLOR, {'/depth': DEPTH, '/k/color': COLOR}, 401.0),
        ('cam', {'/depth': DEPTH, '/k/color': COLOR}, None),
        (COLOR, {'/info': ''}, 400.0),
        ('', {'/info': DEPTH}, 400.0),
        ('zed_left_camera_frame', {'/info': 'zed_left_camera_frame_optical'}, 400.0),
        ('/cam', {'/info': 'cam'}, 400.0),
    ],
)
def test_the_camera_info_of_another_camera_is_named_and_not_used(
    tmp_path: Path, images_of: str, infos_of: dict[str, str], focal: float | None
) -> None:
    infos = {t: camera_info(focal=400.0 + n, frame_id=name) for n, (t, name) in enumerate(infos_of.items())}
    path = write_bag(tmp_path / 'bag', [(m[0], images_of, *m[2:]) for m in make_images()], infos)
    sequence, lines = load_input(path, ReadingOptions(node=LIMITS))
    with Bag(path) as bag:
        result = replay(bag, tmp_path / 'out', ReplayOptions(FAST_CONFIG))
    topic, name = next(iter(infos_of.items()))
    notes = [
        [n for n in said if f'{images_of!r}, but the CameraInfo on {topic} is of {name!r}' in n]
        for said in (lines, result.notes)
    ]
    if focal is None:
        assert (sequence.is_camera_known, result.summary.focal_source) == (False, 'nominal')
        assert [len(said) for said in notes] == [1, 1]
        assert all('/k: ' in line for line in (*notes[0], *notes[1]))
    else:
        assert sequence.intrinsics(1.0).focal == pytest.approx(focal)
        assert result.summary.focal_source == 'known'
        assert result.summary.focal_px == pytest.approx(focal)
        assert notes == [[], []]


def test_kinds_by_name_and_content(tmp_path: Path) -> None:
    save_sequence(tmp_path / 'walk.npz', make_walker())
    (tmp_path / 'walk.dat').write_bytes((tmp_path / 'walk.npz').read_bytes())
    np.savez(tmp_path / 'result.npz', joints3d=np.zeros(1), theta=np.zeros(1), residual_px=np.zeros(1))
    in_folders = 'bag/bag_0.mcap bag.npz/metadata.yaml openpose/a_0_keypoints.json images/1.PNG folder/a.log'
    in_folders += ' images/a.txt labels/a.txt'
    alone = 'a.mcap a.db3 a.bag a.json a.JSON a.MP4 a.m2ts a.gif a.jpeg a.csv a.npy a.bvh a.xyz bad.npz'
    for place in f'{in_folders} {alone}'.split():
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_bytes(b'content')
    (tmp_path / 'own.csv').write_text('time_s,head_x')
    (tmp_path / 'empty.mp4').touch()
    os.mkfifo(tmp_path / 'pipe.npz')
    os.mkfifo(tmp_path / 'pipe.mcap')
    (tmp_path / 'zero.json').symlink_to('/dev/zero')
    names_by_kind = {
        InputKind.SPECIAL: 'pipe.npz pipe.mcap zero.json',
        InputKind.SEQUENCE: 'walk.npz walk.dat bad.npz',
        InputKind.RESULT: 'result.npz',
        InputKind.BAG: 'bag bag.npz a.mcap a.db3 a.bag',
        InputKind.OPENPOSE: 'openpose',
        InputKind.JSON: 'a.json a.JSON',
        InputKind.VIDEO: 'a.MP4 a.m2ts a.gif',
        InputKind.TABLE: 'a.csv a.npy labels',
        InputKind.IMAGE: 'a.jpeg',
        InputKind.IMAGES: 'images',
        InputKind.WRITTEN: 'a.bvh own.csv',
        InputKind.OTHER: 'a.xyz',
        InputKind.FOLDER: 'folder',
        InputKind.EMPTY_FILE: 'empty.mp4',
        InputKind.MISSING: 'none.mp4',
    }
    expected = {name: kind for kind, names in names_by_kind.items() for name in names.split()}
    assert {name: find_input_kind(tmp_path / name) for name in expected} == expected


STEP_NS, HOUR_NS = 40_000_000, 3_600_000_000_000
REGULAR = [START_NS + i * STEP_NS for i in range(FRAMES)]
Edit = Callable[[int, int], int]  # the stamp of an image, of its number and its time in ns


def write_bag_with_clock(folder: Path, edit: Edit) -> Path:
    return write_bag(folder, [(edit(n, t), 'cam', (640, 480), n) for n, t in enumerate(REGULAR)])


@pytest.mark.parametrize(
    ('edit', 'frames', 'line'),
    [
        (lambda _, t: t, FRAMES, ''),
        (lambda _, t: t - START_NS, FRAMES, ''),
        (lambda n, t: t + HOUR_NS * (n >= 25), FRAMES, r'gap of 3600\.0 s after frame 24 \(at 0\.96 s\)'),
        (lambda n, t: t + 5 * STEP_NS * (n >= 25), FRAMES, ''),
        (lambda n, t: t - HOUR_NS * (n >= 25), 25, r'message 26: the stamp goes back by 3600\.0 s; of 2 runs'),
        (lambda n, t: t - 20 * STEP_NS * (n >= 25), 25, '15 messages left out'),  # the same stamps again
        (lambda n, t: t - 27 * STEP_NS * (n >= 28), 28, r'goes back by 1\.0 s; of 2 runs'),
        (lambda n, t: t * (n % 8 > 0), FRAMES - 5, '5 messages left out; .*header.stamp is not set'),
    ],
)  # fmt: skip
def test_a_line_says_what_the_clock_of_a_bag_did(tmp_path: Path, edit: Edit, frames: int, line: str) -> None:
    sequence, lines = load_input(write_bag_with_clock(tmp_path / 'bag', edit), ReadingOptions(node=LIMITS))
    assert (sequence.keypoints[..., 2] > 0).any(axis=1).sum() in (frames, frames + 1)
    assert len(lines) == 1 + bool(line)
    if line:
        assert any(re.search(line, text) for text in lines)


@pytest.mark.parametrize(
    ('edit', 'reason'),
    [
        (lambda _, t: t * 0, 'header.stamp is not set'),
        (lambda n, t: t - (n % 2) * HOUR_NS, 'message 2: the stamp goes back by 3600.0 s; of 21 runs'),
    ],
)
def test_a_bag_without_a_clock_is_refused(tmp_path: Path, edit: Edit, reason: str) -> None:
    with pytest.raises(InputError, match=re.escape(reason)):
        load_input(write_bag_with_clock(tmp_path / 'bag', edit), ReadingOptions(node=LIMITS))


TOO_DENSE, TOO_SPARSE, IN_NS = 1e-3, 1e3, 1e-9  # factors on times
WRONG_UNITS = [
    (TOO_DENSE, '25000 images/s by the stamps: looks like microseconds'),
    (TOO_SPARSE, 'one image every 40 s by the stamps: looks like milliseconds'),
]


def scale_times(factor: float) -> list[Shot]:
    stamps = [START_NS + round((t - START_NS) * factor) for t in REGULAR]
    return [(t, 'cam', (640, 480), n) for n, t in enumerate(stamps)]


@pytest.mark.parametrize(('factor', 'line'), WRONG_UNITS)
def test_a_bag_whose_stamps_have_another_unit_is_refused(tmp_path: Path, factor: float, line: str) -> None:
    with pytest.raises(InputError, match=f'bag: {line}'):
        load_input(write_bag(tmp_path / 'bag', scale_times(factor)), ReadingOptions(node=LIMITS))


@pytest.mark.parametrize('wait_s', [0.0, 1.0])
@pytest.mark.parametrize(
    ('factor', 'line'),
    [*WRONG_UNITS, (IN_NS, 'images/s by the stamps: looks like seconds'), (1.0, ''), (50.0, '')],
)
def test_the_live_pipeline_says_once_that_stamps_have_another_unit(
    factor: float, line: str, wait_s: float
) -> None:
    """Also while no image is used, because the first CameraInfo is waited for by the stamps."""
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.camera_info_wait': wait_s}))
    results = [pipeline.feed(Source.KEYPOINTS, encode_image(image)) for image in scale_times(factor)]
    said = [n for n, result in enumerate(results) if 'by the stamps' in result.reason]
    assert said == ([29] if line else [])
    if line:
        assert line in results[29].reason
        assert any(line in warning for warning in pipeline.checks.warnings)
        summary = pipeline.summary.summarise()
        assert (summary.grade, line in summary.reason) == ('doubtful', True)


@pytest.mark.parametrize('jump_s', [-3600.0, 3600.0, 30.0])
def test_the_live_pipeline_names_a_jump_once(jump_s: float) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    stamps = [t + round(jump_s * 1e9) * (n >= 5) for n, t in enumerate(REGULAR[:10])]
    images = [(t, 'cam', (640, 480), n) for n, t in enumerate(stamps)]
    results = [pipeline.feed(Source.KEYPOINTS, encode_image(image)) for image in images]
    assert [n for n, result in enumerate(results) if 'the ' in result.reason and ' s' in result.reason] == [5]
    expected = 'went back by 3600.0 s' if jump_s < 0 else f'gap of {jump_s:.1f} s before this stamp'
    assert expected in results[5].reason
    assert pipeline.counters.accepted == 10


def reconstruct(folder: Path, sequence: KeypointSequence, gap_s: float, *suffixes: str) -> int:
    times = np.where(np.arange(FRAMES) < 20, 0.0, gap_s) + sequence.timestamps
    save_sequence(folder / 'in.npz', KeypointSequence(sequence.keypoints, sequence.joint_names, times, (640, 480)))
    outputs = [word for suffix in suffixes for word in ('-o', str(folder / f'out{suffix}'))]
    return main(['reconstruct', str(folder / 'in.npz'), *outputs, *QUICK_OPTIONS])


@pytest.mark.parametrize(('suffix', 'gap_s'), [('.trc', 3600.0), ('.bvh', 3600.0), ('.trc', 70.0), ('.bvh', 15.0)])
def test_no_hour_is_added(tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str, gap_s: float) -> None:
    assert reconstruct(tmp_path, make_walker(), gap_s, suffix) == 1
    assert f'a gap of {gap_s:.1f} s after 0.6 s' in capsys.readouterr().err
    assert not (tmp_path / f'out{suffix}').exists()


def test_a_gap_is_empty_in_files_of_a_constant_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert reconstruct(tmp_path, make_walker(), 5.0, '.trc', '.csv', '.npz') == 0
    assert 'a gap of 5.0 s after frame 19' in capsys.readouterr().err
    rows = [line.split('\t') for line in (tmp_path / 'out.trc').read_text().splitlines()[6:]]
    filled = [any(cell.strip() for cell in row[2:]) for row in rows]
    assert (filled.count(True), len(rows)) == (FRAMES, FRAMES + 150)
    assert len((tmp_path / 'out.csv').read_text().splitlines()) == 1 + FRAMES
    assert len(np.load(tmp_path / 'out.npz')['joints3d']) == FRAMES


def test_frames_in_a_long_gap_of_a_person_are_out_of_sight() -> None:
    seen = np.zeros((300, 15), bool)
    seen[[5, 20, 200, 210], 3] = True
    expected = np.isin(np.arange(300), [*range(5, 21), *range(200, 211)])
    np.testing.assert_array_equal(find_frames_in_sight(seen, np.arange(300) / 30), expected)


TURN = 12  # images of each person


def at(shift_px: Sequence[float | None]) -> Detections:
    """Return detections of one person or of none, moved to the right by so many px in each frame."""
    points = np.nan_to_num(walk(1)[0], nan=300.0)
    keypoints = np.column_stack([points, np.full(len(points), 0.9)])
    people = [[] if shift is None else [create_person(keypoints + [shift, 0, 0])] for shift in shift_px]
    return Detections(people, [STEP_NS * i for i in range(len(people))], (640, 480))


def test_a_video_of_two_people_in_turn_gives_one_of_them_and_a_warning(tmp_path: Path) -> None:
    here, there = walk(TURN) - [200.0, 0.0], walk(TURN) + [180.0, 10.0]
    images = [draw([person]) for person in (*here, *there[:5])]
    path = write_video(tmp_path / 'two.mkv', images, [i / 25 for i in range(len(images))])
    model = save_detector(tmp_path / 'detector.onnx')
    sequence, lines = load_input(path, ReadingOptions(detector=model))
    assert len(sequence) == TURN
    assert np.nanmax(sequence.keypoints[..., 0]) < 320
    assert 'choose by --person: person_1 (12), person_2 (5)' in lines[0]
    assert 'at 0.48 s from person_1 to person_2' in lines[2]
    other, _ = load_input(path, ReadingOptions(detector=model, person='person_2'))
    assert len(other) == 5


@pytest.mark.parametrize(
    ('shift_px', 'names', 'changes'),
    [
        ([0, 5, 10, 15], '1111', 0),
        ([0, 5, 300, 305, 310, 12], '112221', 2),
        ([0, None, None, 3], '1..1', 0),
        ([0, 400, 0], '121', 2),
        ([0] + [None] * 100 + [400, 405], '1' + '.' * 100 + '22', 1),  # 4 s later
    ],
)
def test_people_in_turn_are_distinguished(shift_px: list[float | None], names: str, changes: int) -> None:
    named, lines = name_people(at(shift_px))
    assert ''.join(people[0].id.removeprefix('person_') if people else '.' for people in named.people) == names
    assert sum(line.count(' from ') for line in lines) == changes


@dataclass
class BreakingCamera:
    """Images, and then an end of them that a camera may have."""

    images: Sequence[Image]
    error: InputError | None
    image_count = None
    left_out = 0

    def find_focal_length(self, _: tuple[int, int]) -> None:
        return None

    def __iter__(self) -> Iterator[VideoImage]:
        yield from (VideoImage(image, i / 25) for i, image in enumerate(self.images))
        if self.error is not None:
            raise self.error


@pytest.mark.parametrize(
    ('error', 'reason'),
    [
        (InputError('the camera has gone'), 'the camera has gone'),
        (None, r'at 0\.240 s: the size of the images changes'),
    ],
)
def test_what_a_camera_showed_is_kept_when_it_breaks_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: InputError | None, reason: str
) -> None:
    path, model = Path('/dev/video0'), save_detector(tmp_path / 'detector.onnx')
    seen = [draw([person]) for person in walk(6)]
    resized = [] if error else [seen[0][::2, ::2]]
    camera = BreakingCamera([*seen, *resized], error)
    monkeypatch.setattr(detect_people, 'VideoReader', lambda *_, **__: nullcontext(camera))
    found = detect_in_video(path, model, is_camera=True)
    assert [[person.id for person in people] for people in found.people] == [['person_1']] * 6
    assert found.stamps_ns == [STEP_NS * i for i in range(6)]
    assert re.search(f'ended early: .*{reason}', found.notes[1])
    with pytest.raises(InputError, match=reason):
        detect_in_video(path, model)
    camera.images = [draw([])] * 6 + resized
    with pytest.raises(InputError, match=reason):
        detect_in_video(path, model, is_camera=True)


def test_an_empty_video_and_wrong_files_are_named(tmp_path: Path) -> None:
    empty = write_video(tmp_path / 'empty.mkv', [draw([])] * 3, [0.0, 0.1, 0.2])
    model = save_detector(tmp_path / 'detector.onnx')
    with pytest.raises(InputError, match=r'empty\.mkv: no person is seen in any image \(3 images, YOLO-pose'):
        detect_in_video(empty, model)
    with pytest.raises(ModelError, match=r'none\.onnx: no such file'):
        detect_in_video(empty, tmp_path / 'none.onnx')
    with pytest.raises(InputError, match=r'empty\.mkv: is a video, to which --fps does not apply'):
        load_input(empty, ReadingOptions(fps=30.0, detector=model))
    (tmp_path / 'a.json').write_text('[]')
    with pytest.raises(InputError, match=r'a\.json: is a JSON file, to which --detector does not apply'):
        load_input(tmp_path / 'a.json', ReadingOptions(fps=30.0, detector=model))


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return encode_demo_frames(6)


def test_bad_input_is_counted_and_changes_nothing(stream: list[bytes]) -> None:
    clean, disturbed = Pipeline(FAST_CONFIG), Pipeline(FAST_CONFIG)
    for i, raw in enumerate(stream[:6]):
        outputs = process(disturbed, raw)
        assert [o.data for o in process(clean, raw)] == [o.data for o in outputs]
        again = reject(disturbed, raw, Acceptance.DROPPED)
        assert ('repeats' if i else 'header.stamp is not set') in again
        assert 'not a mocap_ros_msgs' in reject(disturbed, raw[:50], Acceptance.INVALID)
        if i:
            assert 'older' in reject(disturbed, stream[i - 1], Acceptance.DROPPED)
    counters = disturbed.counters
    assert (counters.accepted, counters.invalid, counters.dropped['stamp']) == (6, 6, 11)


@pytest.mark.parametrize(('focal', 'is_named'), [(0.0, True), (600.0, False)])
def test_a_nominal_focal_length_is_named_once_after_seconds_of_people(
    focal: float, *, is_named: bool, stream: list[bytes]
) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    if focal:
        pipeline.set_camera_info(camera_info(focal=focal))
    frames = {float(s): with_stamp(stream[0], round(s * 1e9)) for s in np.arange(1, 9, 0.5)}
    reasons = {s: pipeline.feed(Source.KEYPOINTS, raw).reason for s, raw in frames.items()}
    assert [s for s, reason in reasons.items() if 'no CameraInfo' in reason] == ([3.5] if is_named else [])


def test_a_camera_info_that_does_not_fit_is_rejected(stream: list[bytes]) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    with pytest.raises(InputError, match='not calibrated, and width and height are 0'):
        pipeline.set_camera_info(camera_info(0, 0, focal=0))
    assert pipeline.camera_info is None
    pipeline.set_camera_info(camera_info(width=1280))
    reason = reject(pipeline, stream[0], Acceptance.INVALID)
    assert 'CameraInfo is for 1280 x 480 px' in reason


# Distortion coefficients of two lenses, by distortion model.
LENSES = {'plumb_bob': (-0.28, 0.07, 0.001, -0.002, 0.0), 'equidistant': (-0.02, 0.004, -0.001, 0.0002)}


@pytest.mark.parametrize('model', LENSES)
def test_the_distortion_of_camera_info_is_removed(model: str, stream: list[bytes]) -> None:
    focal, lens = 600.0, LENSES[model]
    raw = camera_info(focal=focal, model=model, d=lens)
    camera = decode_camera_info(raw).intrinsics
    assert camera.distortion == Distortion(model, lens)
    pinhole = Intrinsics(focal, (320.0, 240.0), is_focal_known=True)
    distorted, undistorted = [], []
    for message in stream[:5]:
        frame = decode_keypoints(message, FAST_CONFIG.node)
        (person,) = frame.people
        seen = camera.distortion.distort(pinhole.pixels_to_rays(person.points)) * focal + np.array(pinhole.center)
        distorted.append(encode_keypoints(frame.header, (640, 480), [replace(person, points=seen)]))
        undistorted.append(encode_keypoints(frame.header, (640, 480), [person]))

    def joints(inputs: list[bytes], info: bytes, **values: object) -> np.ndarray:
        pipeline = Pipeline(with_values(FAST_CONFIG, values))
        pipeline.set_camera_info(info)
        people = [p for raw in inputs for p in decode_skeletons(process(pipeline, raw)).people]
        return np.array([[j.x, j.y, j.z] for person in people for j in person.joints[:CORE_COUNT]])

    expected = joints(undistorted, camera_info(focal=focal))
    np.testing.assert_allclose(joints(distorted, raw), expected, atol=2e-3)
    rectified = {'node.rectified_input': True}
    np.testing.assert_array_equal(joints(undistorted, raw, **rectified), expected)
    projection = (300.0, 0, 320.0, 0, 0, 300.0, 240.0, 0, 0, 0, 1.0, 0)
    half_focal = joints(undistorted, camera_info(model=model, d=lens, p=projection), **rectified)
    assert half_focal[0, 2] == pytest.approx(expected[0, 2] / 2, rel=0.015)  # measured: 0.0104


@pytest.mark.parametrize(
    ('change', 'restarts'),
    [
        ({'tracker.min_score': 0.5}, True),
        ({'solver.max_iterations': 5}, True),
        ({'node.marker_lifetime': 2.0}, False),
    ],
)
def test_parameters_restart_the_tracker(stream: list[bytes], change: dict[str, object], restarts: bool) -> None:
    changed_config = with_values(FAST_CONFIG, change)
    pipeline, fresh, unchanged = (Pipeline(c) for c in (FAST_CONFIG, changed_config, FAST_CONFIG))
    for raw in stream[:3]:
        process(pipeline, raw)
        process(unchanged, raw)
    assert pipeline.reconfigure(changed_config) == restarts
    skeletons, expected = (process(p, stream[3])[0] for p in (pipeline, fresh if restarts else unchanged))
    assert skeletons.topic == 'skeletons'
    assert skeletons == expected


@pytest.mark.parametrize(
    ('values', 'came_at', 'published', 'is_restarted'),
    [
        ({}, 0, 6, False),
        ({}, 3, 3, False),
        ({}, None, 0, False),
        ({'node.camera_info_wait': 0.1}, None, 3, False),
        ({'node.camera_info_wait': 0.1}, 5, 3, True),
        ({'node.hfov': 60.0}, None, 6, False),
        ({'node.focal': 600.0}, None, 6, False),
    ],
)
def test_people_wait_for_the_first_calibration_unless_a_focal_length_is_given(
    stream: list[bytes], values: dict[str, float], came_at: int | None, published: int, *, is_restarted: bool
) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.camera_info_wait': 1.0, **values}))
    results = []
    for number, raw in enumerate(stream):
        if number == came_at:
            pipeline.set_camera_info(camera_info())
        results.append(pipeline.feed(Source.KEYPOINTS, raw))
    assert all(result.acceptance is Acceptance.ACCEPTED for result in results)
    assert sum(bool(result.outputs) for result in results) == published
    assert any('CameraInfo came late' in result.reason for result in results) == is_restarted
    assert len({person.is_scale_known for person in pipeline.people}) == (published > 0)


@pytest.mark.parametrize(
    ('stamp_ns', 'reason'), [(0, 'header.stamp is not set'), (7_000_000_000, 'stamp 7000000000 ns repeats')]
)
def test_stamps_that_stand_still_are_told_while_waiting(stream: list[bytes], stamp_ns: int, reason: str) -> None:
    pipeline = Pipeline(with_values(FAST_CONFIG, {'node.camera_info_wait': 1.0}))
    assert process(pipeline, with_stamp(stream[0], stamp_ns)) == ()
    for raw in stream[1:]:
        assert reason in reject(pipeline, with_stamp(raw, stamp_ns), Acceptance.DROPPED)
    assert process(pipeline, with_stamp(stream[0], stamp_ns + 1_000_000_000))


def test_tentative_people_are_flagged_and_have_no_transforms(stream: list[bytes]) -> None:
    pipeline = make_calibrated(with_values(FAST_CONFIG, {'node.publish_tf': True}))
    shown = []
    for raw in stream:
        outputs = {o.topic: decode(o.data, o.type) for o in process(pipeline, raw)}
        (person,) = outputs['skeletons'].people
        assert list(outputs['cameras'].ids) == [person.id] == ['person_1']
        assert (len(outputs['markers'].markers), outputs['points'].width) == (2, 26)
        color = outputs['markers'].markers[0].color
        shown.append((person.tentative, color.r == color.g == color.b, len(outputs['/tf'].transforms)))
    assert shown == [(True, True, 0)] * 2 + [(False, False, 26)] * 4


def read_file(keypoints: Array) -> Array:
    times = np.arange(len(keypoints)) / 30
    arrays = {'keypoints': keypoints, 'joint_names': np.array(COCO17), 'timestamps': times}
    return validate_sequence({**arrays, 'image_size': np.array(SIZE)}).keypoints[0, :, 2]


def read_detections(keypoints: Array, size: tuple[int, int] = SIZE) -> Array:
    stamps = [STEP_NS * i for i in range(len(keypoints))]
    return select_person(Detections([[create_person(k)] for k in keypoints], stamps, size))[0].keypoints[0, :, 2]


def read_message(keypoints: Array, stated: tuple[int, int] = SIZE, camera: tuple[int, int] = (0, 0)) -> Array:
    message = encode_keypoints(Header(1, 'camera'), stated, [create_person(keypoints[0])])
    (frame,) = FrameAssembler().assemble(Source.KEYPOINTS, message, '', NodeConfig(), camera, math.inf)
    return frame.people[0].score


def read_array(keypoints: Array) -> Array:
    (person,) = mocap_ros.Tracker('coco17', image_size=SIZE).update(0.0, keypoints[:1]).people
    seen = dict(zip(person.joint_names, ~person.inferred, strict=True))
    return np.array([seen[joint] for joint in COCO17], float)


@pytest.mark.parametrize(
    'read',
    [
        read_file,
        read_detections,
        partial(read_detections, size=(0, 0)),
        read_message,
        partial(read_message, stated=(0, 0), camera=SIZE),
        read_array,
    ],
)
def test_points_on_the_border_of_the_image_are_not_seen(read: Callable[[Array], Array]) -> None:
    keypoints = make_walker().keypoints[:12].copy()
    keypoints[..., 2] = 1
    assert read(keypoints).all()
    ankles = [COCO17.index(joint) for joint in ('lankle', 'rankle')]
    keypoints[:, ankles, 1] = SIZE[1]
    assert np.flatnonzero(read(keypoints) == 0).tolist() == ankles


def test_an_option_counts_for_the_inputs_to_which_it_applies() -> None:
    options = ReadingOptions(fps=30.0, topic='/a', hfov=60.0, node=LIMITS)
    assert select_options(options, InputKind.JSON) == ReadingOptions(fps=30.0, hfov=60.0, node=LIMITS)
    assert select_options(options, InputKind.RESULT) == ReadingOptions(node=LIMITS)
    check_options('x', options._asdict(), InputKind.RESULT, InputKind.JSON, InputKind.BAG)
    with pytest.raises(InputError, match=r'^x: .*to which --topic does not apply'):
        check_options('x', options._asdict(), InputKind.JSON, InputKind.VIDEO)
