# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Images of a video file or a camera, with their times; PyAV of the extra `video` decodes them."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, MocapError, tell_installation
from mocap_ros.formats.sequence_file import MAX_IMAGE_SIDE_PX

if TYPE_CHECKING:
    from typing_extensions import Self

T = TypeVar('T')

CAMERA_FORMAT = 'v4l2'  # of cameras in Linux
CAMERA_DEVICE = '/dev/video{}'  # of a camera that is named by its number
FALLBACK_STEP_S = 1 / 30  # s from image to image, where a video gives neither times nor a rate
FILM_CODECS = ('libx264', 'mpeg4')  # the first that PyAV has encodes a film
FILM_TICK = Fraction(1, 90000)  # s; the times of a film are multiples of it
STREAM_TIMEOUT_S = 10.0  # s; for a stream to answer
READ_AHEAD = 4  # images that are decoded while the detector works; more would only take memory
MICROSECONDS = 1e6  # in a second; the unit of the times of a container
# s; from which on images begin late; times of a container are rounded to 1 us, of images to 1 ms
MIN_LATE_S = 0.001
MAX_MISSING_S = 1.0  # s; the sound of a video may be longer than its images by less
POLL_S = 0.1  # s; bounds how long the decoder outlives a reader who has gone, and how long an end goes unnoticed
JOIN_S = 0.5  # s; the decoder of a camera that gives no more images is left after this, far above an image's time

# Ends of the names under which telephones write their focal length, on film of 35 mm, without underscores.
FOCAL_TAGS = ('focallength.35mmequivalent', 'focallengthin35mmfilm', 'focallengthin35mmformat')
FOCAL_RANGE_MM = 5.0, 500.0  # on film of 35 mm; anything else is damaged
FILM_DIAGONAL_MM = math.hypot(36, 24)  # mm; of the film of 35 mm to which a telephone's focal length refers


class VideoImage(NamedTuple):
    """One image of a video: (H, W, 3) red, green and blue, upright, as players show it; and its time in s."""

    image: NDArray[np.uint8]
    time_s: float


class VideoFacts(NamedTuple):
    """What a video file states of its images."""

    times_s: tuple[float, ...] = ()  # s since the beginning
    size: tuple[int, int] = (0, 0)  # width and height of the images in stored pixels, which detectors see
    pixel_aspect: float = 1.0  # width of a stored pixel per height
    focal_share: float | None = None  # focal length, as a share of the width; None where it is not stated


def _import_av(path: Path | str, what: str) -> Any:
    try:
        import av
    except ImportError:
        raise MocapError(f'{path}: {what} needs PyAV: {tell_installation("video")}') from None
    return av


def find_camera(name: str) -> Path | None:
    """Return the device of a camera that is named by its number or its path, None if it is no camera's name."""
    path = Path(CAMERA_DEVICE.format(name)) if name.isdecimal() and not Path(name).exists() else Path(name)
    is_named = path.parent == Path(CAMERA_DEVICE).parent or (name.isdecimal() and path != Path(name))
    return path if is_named or path.is_char_device() else None


def hide_password(address: str) -> str:
    """Return the address of a stream without the user's name and password."""
    return re.sub(r'(?<=://)[^/@]*@', '', address)


class VideoReader:
    """The images of a video file or a camera in the order of their times; a context manager that closes it.

    The times are those that the file gives, also where they are uneven, since the beginning, which is that of the
    sound where it begins before the images. A video that is stored turned or mirrored, as upright videos of
    telephones are, or in pixels that are not square is shown as players do. An image that is damaged, or not later
    than the one before, is left out. With `is_camera`, a camera is given as the path of its device, and a stream
    as its address.

    Attributes:
        is_live: whether the images come when they are taken; false for a file, also one that an address names.
        image_count: number of images, about; None where it is not known.
        pixel_aspect: width of a stored pixel per height.
        left_out: number of images that were left out so far.
        ending: after the last image, a line that says where the video ended if the file states that it is longer;
            else empty.
    """

    def __init__(self, path: Path | str, *, is_camera: bool = False) -> None:
        av = _import_av(path, 'a video')
        self._path = hide_password(path) if isinstance(path, str) else path
        self._errors = (av.FFmpegError, ValueError)
        self.left_out = 0
        self.ending = ''
        self._is_camera = is_camera
        self._kind = 'camera' if isinstance(path, Path) else 'stream'
        self._container_lock = threading.Lock()  # held while FFmpeg reads, which a camera may keep for ever
        try:  # `file:` and the list of protocols keep a name or a playlist from opening anything but files
            self._container: Any = (
                av.open(str(path), format=CAMERA_FORMAT)
                if is_camera and isinstance(path, Path)
                else av.open(path, timeout=STREAM_TIMEOUT_S)
                if isinstance(path, str)
                else av.open(f'file:{path}', options={'protocol_whitelist': 'file'}, metadata_errors='ignore')
            )
        except self._errors as error:
            raise InputError(
                f'{self._path}: no {self._kind if is_camera else "video that can be read"} ({_describe(error)})'
            ) from None
        self.is_live = is_camera and (isinstance(path, Path) or self._container.duration is None)
        self._stream: Any = next(iter(self._container.streams.video), None)
        if self._stream is None:
            self._container.close()
            raise InputError(f'{self._path}: holds no video')
        if getattr(self._stream, 'codec_context', None) is None:
            self._container.close()
            raise InputError(f'{self._path}: its codec is not known, so that it cannot be decoded')
        self._stream.thread_type = 'SLICE' if self.is_live else 'AUTO'  # threads of whole images are late by some
        self.focal_mm = _read_focal_length(self._container.metadata, self._stream.metadata)
        self.image_count = None if is_camera else self._count_images()
        self.pixel_aspect = float(self._stream.sample_aspect_ratio or 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        # Closing what another thread reads would crash. The lock stays locked: what is closed must not be read.
        if self._container_lock.acquire(blocking=False):
            self._container.close()

    def _count_images(self) -> int | None:
        stream = self._stream
        if stream.frames:
            return int(stream.frames)
        duration_s = float(self._container.duration or 0) / MICROSECONDS
        return round(duration_s * float(stream.average_rate)) or None if stream.average_rate else None

    def find_focal_length(self, size: tuple[int, int]) -> float | None:
        """Return the focal length in px, in images of this size in px; None where the file states none."""
        return None if self.focal_mm is None else self.focal_mm / FILM_DIAGONAL_MM * math.hypot(*size)

    def read_times(self) -> tuple[float, ...]:
        """Return the times in s of all images, without decoding any, in place of the iteration.

        Images before the first that can be decoded alone, as in a recording of a broadcast, are none.
        """
        stamps, has_begun = set(), False
        with suppress(*self._errors):  # the rest of the file is missing or damaged
            for packet in self._container.demux(self._stream):
                has_begun = has_begun or packet.is_keyframe
                if has_begun and packet.pts is not None and not packet.is_discard:
                    stamps.add(packet.pts)
        if not stamps:
            raise InputError(f'{self._path}: states no times of its images')
        start_s = self._find_start(float(min(stamps) * self._stream.time_base))
        return tuple(float(stamp * self._stream.time_base) - start_s for stamp in sorted(stamps))

    def _find_start(self, first_s: float) -> float:
        """Return the time in s that players call 0: of the first image, or of the sound before it."""
        start_s = float(self._container.start_time or 0) / MICROSECONDS
        is_late = not self._is_camera and self._container.start_time is not None and start_s < first_s - MIN_LATE_S
        return start_s if is_late else first_s

    def __iter__(self) -> Iterator[VideoImage]:
        """Yield the images; InputError where none can be decoded."""
        begin_s = last_s = None
        for frame in self._decode():
            time_s = frame.time
            if time_s is None:
                rate = self._stream.average_rate
                time_s = 0.0 if last_s is None else last_s + (1 / float(rate) if rate else FALLBACK_STEP_S)
            if last_s is not None and time_s <= last_s:
                self.left_out += 1
                continue
            width = max(round(frame.width * self.pixel_aspect), 1)
            if max(width, frame.height) > MAX_IMAGE_SIDE_PX:
                raise InputError(f'{self._path}: images of {width} x {frame.height} px')
            begin_s, last_s = self._find_start(time_s) if begin_s is None else begin_s, time_s
            pixels = frame.to_ndarray(format='rgb24', width=width, height=frame.height)
            image = _turn_as_players_do(pixels, frame.side_data.get('DISPLAYMATRIX'))
            yield VideoImage(np.ascontiguousarray(image), time_s - begin_s)
        if last_s is None:
            reason = f': all {self.left_out} are damaged' if self.left_out else ''
            raise InputError(f'{self._path}: no image can be decoded{reason}')
        start_s, stated_s = (
            float(t or 0) / MICROSECONDS for t in (self._container.start_time, self._container.duration)
        )
        if 'matroska' in self._container.format.name:
            start_s = 0.0  # it states the end, and not the length
        if last_s - start_s + MAX_MISSING_S < stated_s:
            self.ending = f'cut off after {last_s - start_s:.1f} s of the {stated_s:.1f} s that the file states'

    def _decode(self) -> Iterator[Any]:
        packets = self._container.demux(self._stream)
        while True:
            try:
                with self._container_lock:
                    packet = next(packets)
            except StopIteration:
                return
            except self._errors as error:  # the rest of the file is missing or damaged
                if self._is_camera:
                    raise InputError(f'{self._path}: the {self._kind} has gone ({_describe(error)})') from None
                self.left_out += 1
                return
            try:
                with self._container_lock:
                    frames = packet.decode()
                yield from frames
            except self._errors:
                self.left_out += 1


def read_video_facts(path: Path) -> VideoFacts:
    """Return what a video file states of its images, of which only the first is decoded."""
    with VideoReader(path) as reader:
        times_s = reader.read_times()
    with VideoReader(path) as reader:
        height, width = next(iter(reader)).image.shape[:2]
        stored = round(width / reader.pixel_aspect), height
        focal_px = reader.find_focal_length((width, height))
        return VideoFacts(times_s, stored, reader.pixel_aspect, None if focal_px is None else focal_px / width)


def _turn_as_players_do(image: NDArray[np.uint8], matrix: Any) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) turned and mirrored by the display matrix of its video, which may be None.

    Its nine fixed-point numbers a, b, u, c, d, ... show the point (x, y) at (a x + c y, b x + d y).
    """
    if matrix is None:
        return image
    a, b, _, c, d = np.frombuffer(bytes(matrix), np.int32)[:5].tolist()
    if abs(a) + abs(d) < abs(b) + abs(c):
        image, a, d = image.swapaxes(0, 1), c, b
    return image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]


def read_ahead(
    items: Iterator[T], depth: int = READ_AHEAD, is_ended: Callable[[], bool] | None = None
) -> Generator[T]:
    """Yield the items, of which another thread takes up to `depth` ahead; an error of their iterator comes last.

    While no item is there, `is_ended` says whether to wait no longer; a thread whose iterator does not return
    within `JOIN_S` is then left behind. By default every item is waited for, and so is the end of the thread.
    """
    queue: Queue[tuple[bool, Any]] = Queue(depth)
    is_closed = threading.Event()

    def put(is_item: bool, value: object) -> bool:
        """Hand on a value; return False if the reader has gone."""
        while not is_closed.is_set():
            try:
                queue.put((is_item, value), timeout=POLL_S)
            except Full:
                continue
            return True
        return False

    def fetch() -> None:
        try:
            if all(put(True, item) for item in items):
                put(False, None)
        except BaseException as error:  # it is raised in the thread that reads
            put(False, error)

    thread = threading.Thread(target=fetch, name='read_ahead', daemon=True)
    thread.start()
    try:
        while True:
            is_item, value = _take(queue, is_ended)
            if not is_item:
                break
            yield value
    finally:
        is_closed.set()
        thread.join(None if is_ended is None else JOIN_S)
    if value is not None:
        raise value


def _take(queue: Queue[tuple[bool, Any]], is_ended: Callable[[], bool] | None) -> tuple[bool, Any]:
    """Return the next entry of a queue of `read_ahead`, or that of the end if `is_ended` says so."""
    if is_ended is None:
        return queue.get()
    while True:
        with suppress(Empty):
            return queue.get(timeout=POLL_S)
        if is_ended():
            return False, None


def _read_focal_length(*metadata: Mapping[str, str]) -> float | None:
    """Return the focal length in mm on film of 35 mm that telephones write into their videos; None if none is."""
    for key, text in (item for tags in metadata for item in tags.items()):
        if key.lower().replace('_', '').endswith(FOCAL_TAGS):
            with suppress(ValueError):
                if FOCAL_RANGE_MM[0] <= (value := float(text)) <= FOCAL_RANGE_MM[1]:
                    return value
    return None


def _describe(error: Exception) -> str:
    return str(getattr(error, 'strerror', None) or error).rstrip('.')


def write_video(path: Path, images: Iterable[tuple[float, NDArray[np.uint8]]]) -> None:
    """Write an .mp4 of times in s and images (H, W, 3), red, green and blue, all of the size of the first."""
    av = _import_av(path, 'a film')
    codec = next(name for name in FILM_CODECS if name in av.codecs_available)
    start_s = 0.0
    newest = -1
    stream: Any = None
    try:
        with av.open(str(path), 'w', format='mp4') as container:
            for time_s, image in images:
                if stream is None:
                    stream = container.add_stream(codec, rate=30)
                    stream.height, stream.width = (side // 2 * 2 for side in image.shape[:2])
                    stream.pix_fmt = 'yuv420p'
                    start_s = time_s
                    stream.time_base = stream.codec_context.time_base = FILM_TICK
                even = np.ascontiguousarray(image[: stream.height, : stream.width])
                frame = av.VideoFrame.from_ndarray(even, format='rgb24')
                newest = max(round((time_s - start_s) / FILM_TICK), newest + 1)
                frame.pts = newest
                frame.time_base = FILM_TICK
                container.mux(stream.encode(frame))
            if stream is not None:
                container.mux(stream.encode(None))
    except (av.FFmpegError, ValueError) as error:
        raise MocapError(f'{path}: the film cannot be written ({_describe(error)})') from None
