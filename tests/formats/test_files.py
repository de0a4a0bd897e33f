# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sequence files are read as they were written, invalid ones refused; files are written whole or not at all;
videos: times, turned images, and files that cannot be read."""

import errno
import os
import stat
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap_ros import npz_file
from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.sequence_file import load_sequence, save_sequence, validate_sequence
from mocap_ros.formats.text_files import replace_output
from mocap_ros.formats.video import VideoReader, find_camera, read_ahead, read_video_facts
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
from mocap_ros.recordings.input_kind import InputKind, find_input_kind
from mocap_ros.skeleton import keypoint_layout
from tests.support.blob_people import write_video

FRAMES = 5
JOINTS = keypoint_layout('coco17').joints


@pytest.fixture
def sequence(rng: np.random.Generator) -> KeypointSequence:
    keypoints = rng.uniform(0.2, 1, (FRAMES, len(JOINTS), 3)).astype('f4').astype(float)
    keypoints[..., :2] *= 512
    keypoints[1, 2] = [np.nan, np.nan, 0]
    return KeypointSequence(
        keypoints=keypoints,
        joint_names=JOINTS,
        timestamps=np.arange(FRAMES) / 30,
        image_size=(640, 480),
        camera_matrix=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
        distortion=np.array([0.1, 0, 0, 0]),
        truth=GroundTruth(np.ones((FRAMES, 2, 3)), ('neck', 'pelvis')),
    )


def test_round_trip(tmp_path: Path, sequence: KeypointSequence) -> None:
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    loaded = load_sequence(path)
    assert sequence.truth is not None
    assert loaded.truth is not None
    assert loaded.joint_names == sequence.joint_names
    assert loaded.image_size == sequence.image_size
    for field in ('keypoints', 'timestamps', 'camera_matrix', 'distortion'):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(sequence, field))
    np.testing.assert_array_equal(loaded.truth.joints, sequence.truth.joints)
    assert loaded.truth.joint_names == sequence.truth.joint_names


def set_element(arrays: dict[str, Any], key: str, index: Any, value: float) -> None:
    arrays[key] = arrays[key].copy()
    arrays[key][index] = value


INVALID: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda a: a.pop('keypoints'), 'keypoints: missing'),
    (lambda a: a.update(keypoints=np.array([None], object)), 'keypoints: holds Python objects$'),
    (lambda a: a.update(timestamps=np.array(['now'])), 'timestamps: holds <U3'),
    (lambda a: a.update(keypoints=a['keypoints'][..., :2]), r'keypoints: shape .* expected \(5, 17, 3\)'),
    (lambda a: a.update(keypoints=a['keypoints'][:3]), r'keypoints: shape \(3,'),
    (lambda a: a.update(joint_names=np.array([f'j{i}' for i in range(17)])), 'joint_names: .* fewer than four'),
    (lambda a: set_element(a, 'keypoints', (3, 7, 1), np.inf), 'keypoints: frame 3: y of lelbow is inf'),
    (lambda a: set_element(a, 'keypoints', (4, 0, 2), np.inf), 'keypoints: frame 4: score of nose is inf'),
    (lambda a: set_element(a, 'keypoints', (..., 2), 0), 'keypoints: every score is 0'),
    (lambda a: a.update(keypoints=a['keypoints'] / [512, 512, 1]), 'keypoints: looks normalised; px expected'),
    (lambda a: a.update(theta=np.zeros(0), residual_px=np.zeros(0)), 'is a result of reconstruct'),
    (lambda a: set_element(a, 'timestamps', 2, 1 / 30), 'timestamps: frame 2: .* repeats frame 1'),
    (lambda a: set_element(a, 'timestamps', 4, 0.01), 'timestamps: frame 4: .* is not later than frame 3'),
    (lambda a: set_element(a, 'timestamps', 1, np.nan), 'timestamps: frame 1: nan s'),
    (
        lambda a: a.update(timestamps=1.76e12 + np.arange(FRAMES) * 33.3),
        r'timestamps: frame 0: 1\.76e\+12 s; one image every 33\.3 s by the stamps: looks like milliseconds',
    ),
    (
        lambda a: a.update(keypoints=a['keypoints'] + [400, -50, 0], image_size=np.array([480, 1000])),
        'image_size: .* look transposed$',
    ),
    (lambda a: a.update(timestamps=np.zeros(0)), 'timestamps: no frames'),
    (lambda a: set_element(a, 'image_size', 1, 0), 'image_size: 640 x 0 px'),
    (lambda a: set_element(a, 'camera_matrix', (0, 0), 0), 'camera_matrix: focal length'),
    (lambda a: a.update(distortion=np.ones(3)), 'distortion: plumb_bob takes 4 or 5 coefficients, not 3'),
    (lambda a: a.update(distortion=np.array([0.1, -1e300, 0, 0])), r'distortion: -1e\+300'),
    (lambda a: set_element(a, 'joints3d', (3, 1, 2), 3e38), 'joints3d: frame 3: pelvis is more than'),
    (lambda a: a.update(joints3d=a['joints3d'][:2]), r'joints3d: shape \(2, 2, 3\)'),
]


@pytest.mark.parametrize(('edit', 'message'), INVALID)
def test_invalid_content_is_refused_by_file_key_and_frame(
    tmp_path: Path, sequence: KeypointSequence, edit: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    with np.load(path) as archive:
        arrays = dict(archive)
    edit(arrays)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=rf'walk\.npz: {message}'):
        load_sequence(path)


@pytest.mark.parametrize(
    ('given', 'note'),
    [
        (JOINTS, ()),
        (
            ['lwirst' if j == 'lwrist' else j for j in JOINTS],
            ("joint_names: no known joints, used by their places: 'lwirst' as 'lwrist'",),
        ),
    ],
)
def test_names_that_no_layout_has_are_noted(given: Sequence[str], note: tuple[str, ...]) -> None:
    keypoints = np.ones((1, len(JOINTS), 3)) * np.arange(1, 1 + len(JOINTS))[:, None]
    arrays = {'keypoints': keypoints, 'timestamps': np.zeros(1), 'image_size': np.array([640, 480])}
    sequence = validate_sequence({**arrays, 'joint_names': np.array(given)})
    assert (sequence.joint_names, sequence.notes) == (JOINTS, note)


def test_invalid_files_are_refused(tmp_path: Path, sequence: KeypointSequence) -> None:
    valid = tmp_path / 'walk.npz'
    save_sequence(valid, sequence)
    invalid = {'cut.npz': valid.read_bytes()[:-700], 'text.npz': b'keypoints: none', 'empty.npz': b''}
    for name, content in invalid.items():
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=f'{name}: not a sequence file') as caught:
            load_sequence(path)
        assert 'pickle' not in str(caught.value)
    np.save(tmp_path / 'single.npy', np.zeros(3))
    (tmp_path / 'folder').mkdir()
    faults = {'single.npy': 'not a sequence file', 'none': 'No such file', 'folder': 'Is a directory'}
    for name, fault in faults.items():
        with pytest.raises(InputError, match=f'{name}: {fault}'):
            load_sequence(tmp_path / name)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, fault = tmp_path / 'bomb.npz', r'bomb\.npz: not a sequence file: unpacks to more than 100 times its size'
    np.savez_compressed(path, timestamps=np.zeros(10**6))
    with pytest.raises(InputError, match='holds more than 1 MiB'), npz_file.open_npz(path, 1 << 20):
        pass
    monkeypatch.setattr(npz_file, 'UNPACKED_BYTES', 0)
    with pytest.raises(InputError, match=fault):
        load_sequence(path)


@pytest.mark.parametrize('is_old', [False, True])
@pytest.mark.parametrize(
    ('error', 'told', 'message'),
    [
        (OSError(errno.ENOSPC, 'No space left'), MocapError, r'out\.npz: cannot be written: No space left$'),
        (InputError('frame 3'), InputError, 'frame 3'),
        (KeyboardInterrupt(), KeyboardInterrupt, '^$'),
        (SystemExit(1), SystemExit, '1'),
    ],
)
def test_an_error_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, error: BaseException, told: type[BaseException], message: str, is_old: bool
) -> None:
    path = tmp_path / 'out.npz'
    if is_old:
        path.write_text('old')

    def write() -> None:
        with replace_output(path) as unfinished:
            assert unfinished.name == 'out.npz'
            unfinished.write_text('ne')
            raise error

    with pytest.raises(told, match=message) as raised:
        write()
    assert type(raised.value) is told
    assert [file.read_text() for file in tmp_path.iterdir()] == ['old'] * is_old


def test_a_missing_folder_is_made(tmp_path: Path) -> None:
    with replace_output(tmp_path / 'a' / 'b' / 'out.npz') as unfinished:
        unfinished.write_text('new')
    assert (tmp_path / 'a' / 'b' / 'out.npz').read_text() == 'new'


def test_an_existing_file_keeps_its_permissions_and_a_new_one_has_the_usual_ones(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        for name, mode in (('old.npz', 0o604), ('new.npz', None)):
            path = tmp_path / name
            if mode is not None:
                path.write_text('old')
                path.chmod(mode)
            with replace_output(path) as unfinished:
                unfinished.write_text('new')
            assert path.read_text() == 'new'
            assert stat.S_IMODE(path.stat().st_mode) == (mode or 0o640)
    finally:
        os.umask(before)


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    for folder in ('here', 'there'):
        (tmp_path / folder).mkdir()
    link, file = tmp_path / 'here' / 'link.npz', tmp_path / 'there' / 'data'
    link.symlink_to(file)
    for content in ('first', 'second'):
        with replace_output(link) as unfinished:
            assert unfinished.name == 'link.npz'
            assert unfinished.parent.parent == file.parent
            unfinished.write_text(content)
        assert link.is_symlink()
        assert file.read_text() == content
    assert set(tmp_path.rglob('*')) == {link.parent, file.parent, link, file}


def test_a_source_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / 'in').write_text('old')
    (tmp_path / 'out').symlink_to('in')
    places = [tmp_path / name for name in ('out', 'other', 'in')]
    message = 'out: not written, because it is the input file'
    with pytest.raises(MocapError, match=message), replace_output(*places) as unfinished:
        unfinished.write_text('new')
    assert (tmp_path / 'in').read_text() == 'old'


def test_the_standard_output_is_written_directly(tmp_path: Path) -> None:
    """Also where it leads to a file, which has no name that could be given to another one."""
    code = (
        'from pathlib import Path; from mocap_ros.formats.text_files import replace_output\n'
        "with replace_output(Path('/dev/stdout')) as place: place.write_text(str(place))\n"
    )
    with (tmp_path / 'out').open('wb') as file:
        subprocess.run([sys.executable, '-c', code], cwd=tmp_path, stdout=file, check=True)
        assert os.fstat(file.fileno()).st_ino == (tmp_path / 'out').stat().st_ino
    assert (tmp_path / 'out').read_text() == '/dev/stdout'


pytest.importorskip('av', reason="needs PyAV: pip install 'mocap_ros[video]'")

TIMES_S = [0.0, 0.04, 0.09, 0.2, 0.21, 0.5]  # of a camera that drops images
ONE = 1 << 16  # 1 in the fixed-point numbers of the matrix in an .mp4


def make_images(count: int = len(TIMES_S)) -> list[np.ndarray]:
    """Return images (48, 64, 3), each of a grey of its own, with a red corner at the upper left."""
    images = []
    for index in range(count):
        image = np.full((48, 64, 3), 20 * index, np.uint8)
        image[:16, :16] = [255, 0, 0]
        images.append(image)
    return images


def read_all(path: Path) -> tuple[np.ndarray, list[float], VideoReader]:
    with VideoReader(path) as reader:
        images, times = zip(*reader, strict=True)
    return np.array(images), list(times), reader


def test_uneven_times_are_kept_and_begin_with_0(tmp_path: Path) -> None:
    late = [t + 7.5 for t in TIMES_S]
    for name, codec, pixels in (('a.mkv', 'ffv1', 'bgr0'), ('a.mp4', 'libx264', 'yuv420p')):
        images, times, reader = read_all(write_video(tmp_path / name, make_images(), late, codec, pixels))
        assert times == pytest.approx(TIMES_S, abs=1e-9)
        assert images[:, -1, -1, 0] == pytest.approx([20 * i for i in range(len(times))], abs=6)
        assert (reader.left_out, reader.ending) == (0, '')
    assert reader.image_count == len(times)


@pytest.mark.parametrize('name', ['a.mp4', 'a.ts'])
def test_pixels_that_are_not_square_are_shown_as_players_do(tmp_path: Path, name: str) -> None:
    path = write_video(tmp_path / name, make_images(), TIMES_S, 'libx264', 'yuv420p', aspect=1.5)
    images, times, reader = read_all(path)
    assert times == pytest.approx(TIMES_S, abs=1e-4)
    assert images.shape[1:] == (48, 96, 3)
    assert np.flatnonzero((images[0, ..., 0] > 128).any(axis=0)).tolist() == list(range(24))
    assert find_input_kind(path) is InputKind.VIDEO
    facts = read_video_facts(path)
    assert (facts.size, facts.pixel_aspect, reader.ending) == ((64, 48), 1.5, '')


def test_a_broadcast_begins_with_the_first_image_that_can_be_decoded(tmp_path: Path) -> None:
    path = write_video(tmp_path / 'a.ts', make_images(12) * 50, [i / 25 for i in range(600)], 'libx264', 'yuv420p')
    path.write_bytes(path.read_bytes()[188 * 60 :])  # in packets of 188 bytes
    _, times, _ = read_all(path)
    assert 100 < len(times) < 590
    assert read_video_facts(path).times_s == pytest.approx(times)


def test_images_that_begin_later_than_the_sound_have_the_times_of_players(tmp_path: Path) -> None:
    import av

    with av.open(str(tmp_path / 'a.mkv'), 'w') as container:
        sound, images = container.add_stream('pcm_s16le', rate=8000), container.add_stream('ffv1', rate=25)
        images.width, images.height, images.pix_fmt = 64, 48, 'bgr0'
        heard = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format='s16', layout='mono')
        heard.sample_rate, heard.pts = 8000, 0
        container.mux(sound.encode(heard))
        for index, image in enumerate(make_images()):
            frame = av.VideoFrame.from_ndarray(image, format='rgb24').reformat(format='bgr0')
            frame.pts = 50 + index
            container.mux(images.encode(frame))
        container.mux(images.encode(None))
    _, times, _ = read_all(tmp_path / 'a.mkv')
    assert times == pytest.approx([2 + i / 25 for i in range(len(TIMES_S))], abs=1e-3)
    assert read_video_facts(tmp_path / 'a.mkv').times_s == pytest.approx(times)


@pytest.mark.parametrize(
    ('matrix', 'is_upright', 'corner'),
    [
        ((0, 1, -1, 0), True, 'upper right'),  # a quarter of a turn clockwise
        ((0, -1, 1, 0), True, 'lower left'),
        ((-1, 0, 0, -1), False, 'lower right'),
        ((-1, 0, 0, 1), False, 'upper right'),  # mirrored
        ((0, 1, 1, 0), True, 'upper left'),  # mirrored and turned
        ((0, -1, -1, 0), True, 'lower right'),
    ],
)
def test_turned_videos_are_upright(tmp_path: Path, matrix: tuple[int, ...], is_upright: bool, corner: str) -> None:
    path = write_video(tmp_path / 'a.mp4', make_images(), TIMES_S, 'libx264', 'yuv420p')
    content, (a, b, c, d) = path.read_bytes(), matrix
    start = content.index(struct.pack('>9i', ONE, 0, 0, 0, ONE, 0, 0, 0, 1 << 30), content.index(b'tkhd'))
    turned = struct.pack('>9i', a * ONE, b * ONE, 0, c * ONE, d * ONE, 0, 0, 0, 1 << 30)
    path.write_bytes(content[:start] + turned + content[start + 36 :])
    images, _, _ = read_all(path)
    assert images.shape == (len(TIMES_S), *((64, 48) if is_upright else (48, 64)), 3)
    red = images[0, ..., 0] > 128
    for axis, first in enumerate(('left', 'upper')):
        side = red.shape[1 - axis]
        place = range(16) if first in corner else range(side - 16, side)
        assert np.flatnonzero(red.any(axis=axis)).tolist() == list(place)


@pytest.mark.parametrize('name', ['text.mp4', 'sound.mka', 'none.mp4', 'unknown.mkv'])
def test_what_is_no_video_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    import av

    (tmp_path / 'text.mp4').write_text('no video')
    whole = write_video(tmp_path / 'a.mkv', make_images(), TIMES_S).read_bytes()
    (tmp_path / 'unknown.mkv').write_bytes(whole.replace(b'V_FFV1', b'V_NONE'))
    with av.open(str(tmp_path / 'sound.mka'), 'w') as container:
        stream = container.add_stream('pcm_s16le', rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format='s16', layout='mono')
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
    with pytest.raises(InputError, match=r'no video that can be read \(.+\)$|holds no video$|codec') as raised:
        VideoReader(tmp_path / name)
    assert str(raised.value).startswith(f'{tmp_path / name}: ')


def test_a_camera_is_named_by_number_or_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_camera('3') == Path('/dev/video3')
    assert find_camera('/dev/null') == Path('/dev/null')
    assert find_camera('walk.mp4') is None
    (tmp_path / '3').touch()
    assert find_camera('3') is None
    with pytest.raises(InputError, match=r'/dev/null: no camera \(.+\)$'):
        VideoReader(Path('/dev/null'), is_camera=True)


def test_a_camera_that_gives_no_image_is_not_closed_while_it_is_read(tmp_path: Path) -> None:
    """FFmpeg would crash; a video takes the place of the camera."""
    is_read, is_released = threading.Event(), threading.Event()
    closed: list[bool] = []

    def demux(_: object) -> Iterator[None]:
        is_read.set()
        is_released.wait(20)  # s, far above what the test takes
        yield from ()

    with VideoReader(write_video(tmp_path / 'a.mkv', make_images(), TIMES_S)) as reader:
        reader._container = SimpleNamespace(demux=demux, close=lambda: closed.append(True))
        assert list(read_ahead(iter(reader), is_ended=is_read.is_set)) == []
    assert not closed
    is_released.set()


def test_a_video_that_was_cut_off_says_where_it_ended(tmp_path: Path) -> None:
    path = write_video(tmp_path / 'a.mkv', make_images(12) * 10, [i / 30 for i in range(120)])
    *_, whole = read_all(path)
    assert not whole.ending
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    _, times, reader = read_all(path)
    assert 30 < len(times) < 90
    assert reader.ending == f'cut off after {times[-1]:.1f} s of the 4.0 s that the file states'
    short = VideoReader(path)
    next(iter(short))
    assert not short.ending  # somebody who stops reading learns nothing about the end


@pytest.mark.parametrize(
    ('key', 'text', 'expected'),
    [
        ('com.apple.quicktime.camera.focal_length.35mm_equivalent', '26', 26.0),
        ('FocalLengthIn35mmFilm', '24.5', 24.5),
        ('FocalLengthIn35mmFilm', '0', None),
        ('FocalLengthIn35mmFilm', 'wide', None),
        ('com.apple.quicktime.model', '26', None),
    ],
)
def test_focal_lengths_of_telephones_are_read(tmp_path: Path, key: str, text: str, expected: float | None) -> None:
    import av

    path = tmp_path / 'v.mov'
    with av.open(str(path), 'w', options={'movflags': 'use_metadata_tags'}) as container:
        container.metadata[key] = text
        stream = container.add_stream('mpeg4', 30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, 'yuv420p'
        for packet in (*stream.encode(av.VideoFrame(64, 48, 'yuv420p')), *stream.encode()):
            container.mux(packet)
    with VideoReader(path) as reader:
        assert reader.focal_mm == expected
