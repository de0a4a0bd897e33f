# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading of videos: times, turned images, and files that cannot be read."""

import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.video import VideoReader, find_camera, read_ahead
from tests.support.blob_people import write_video

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
        assert reader.left_out == 0
    assert reader.image_count == len(times)


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
