# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Images of `sensor_msgs/msg/Image` and `sensor_msgs/msg/CompressedImage` as red, green and blue, or as depths.

The encodings are those of the header `image_encodings.hpp` of sensor_msgs. A Bayer pattern is demosaiced in the
simplest way: every square of two by two pixels gets one colour, which is enough for a keypoint detector.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import UnidentifiedImageError

from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import Header, decode, validate_header

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
IMAGE_TYPES = (IMAGE, COMPRESSED_IMAGE)
MAX_IMAGE_PIXELS = 1 << 26  # px; guards the memory, above the largest cameras of today

Numbers = NDArray[np.generic]  # (H, W, C) as they are in a message
Pixels = NDArray[np.uint8]  # (H, W, 3) red, green, blue
Depths = NDArray[np.uint16] | NDArray[np.float64]  # (H, W)

# Contributions of the two differences of colour to red, green and blue (ITU-R BT.601, full range).
RED_BY_V, GREEN_BY_U, GREEN_BY_V, BLUE_BY_U = 1.402, -0.344136, -0.714136, 1.772


def _pick(*channels: int) -> Callable[[Numbers], Numbers]:
    return lambda values: values[..., channels]


def _pick_high_bytes(*channels: int) -> Callable[[Numbers], Numbers]:
    return lambda values: values[..., channels] >> 8  # type: ignore[operator]


def _stretch_grey(values: Numbers) -> Numbers:
    """Return grey numbers of two bytes, stretched to what the image holds: infrared cameras use 10 or 12 bits."""
    grey = values.astype(np.float32)
    return (grey * (255.0 / max(float(grey.max()), 1.0)))[..., [0, 0, 0]]


def _demosaic(red: tuple[int, int], blue: tuple[int, int]) -> Callable[[Numbers], Numbers]:
    """Return a function that demosaics a pattern with red and blue in these rows and columns of each square."""

    def convert(values: Numbers) -> Numbers:
        if min(values.shape[:2]) < 2:
            raise InputError(f'width, height: {values.shape[1]} x {values.shape[0]} px, less than a Bayer pattern')
        plane = values[: len(values) // 2 * 2, : values.shape[1] // 2 * 2, 0].astype(np.uint16)
        part = {(row, column): plane[row::2, column::2] for row in (0, 1) for column in (0, 1)}
        greens = [part[place] for place in part if place not in (red, blue)]
        squares = np.stack([part[red], (greens[0] + greens[1]) // 2, part[blue]], axis=-1)
        whole = squares.repeat(2, axis=0).repeat(2, axis=1)
        odd = values.shape[0] - whole.shape[0], values.shape[1] - whole.shape[1]
        return np.pad(whole, [(0, odd[0]), (0, odd[1]), (0, 0)], mode='edge')

    return convert


def _convert_yuv(y: int, u: int, v: int) -> Callable[[Numbers], Numbers]:
    """Return a function for pairs of pixels of four bytes, the y of which are the bytes `y` and `y + 2`."""

    def convert(values: Numbers) -> Numbers:
        if values.shape[1] % 2:
            raise InputError(f'width: {values.shape[1]} is odd, and two pixels share a colour in this encoding')
        pairs = values.reshape(len(values), -1, 4).astype(np.float32)
        luma = pairs[..., [y, y + 2]].reshape(len(values), -1)
        u_, v_ = ((pairs[..., channel] - 128.0).repeat(2, axis=1) for channel in (u, v))
        rgb = [luma + RED_BY_V * v_, luma + GREEN_BY_U * u_ + GREEN_BY_V * v_, luma + BLUE_BY_U * u_]
        return np.clip(np.stack(rgb, axis=-1) + 0.5, 0.0, 255.0)

    return convert


_RGB, _BGR, _GREY = _pick(0, 1, 2), _pick(2, 1, 0), _pick(0, 0, 0)  # indices of red, green and blue
_UYVY, _YUYV = _convert_yuv(1, 0, 2), _convert_yuv(0, 1, 3)  # places of y, u and v in four bytes
# Row and column of red and of blue in the square of each Bayer pattern.
_BAYER = {'rggb': ((0, 0), (1, 1)), 'bggr': ((1, 1), (0, 0)), 'gbrg': ((1, 0), (0, 1)), 'grbg': ((0, 1), (1, 0))}
# Of each encoding the bytes and channels of a pixel, and what makes red, green and blue of them.
_ENCODINGS: dict[str, tuple[type[np.generic], int, Callable[[Numbers], Numbers]]] = {
    'rgb8': (np.uint8, 3, _RGB),
    'rgba8': (np.uint8, 4, _RGB),
    'bgr8': (np.uint8, 3, _BGR),
    'bgra8': (np.uint8, 4, _BGR),
    '8UC3': (np.uint8, 3, _BGR),  # OpenCV's order
    '8UC4': (np.uint8, 4, _BGR),
    'rgb16': (np.uint16, 3, _pick_high_bytes(0, 1, 2)),
    'bgr16': (np.uint16, 3, _pick_high_bytes(2, 1, 0)),
    'mono8': (np.uint8, 1, _GREY),
    '8UC1': (np.uint8, 1, _GREY),
    'mono16': (np.uint16, 1, _stretch_grey),
    '16UC1': (np.uint16, 1, _stretch_grey),
    'yuv422': (np.uint8, 2, _UYVY),
    'uyvy': (np.uint8, 2, _UYVY),
    'yuv422_yuy2': (np.uint8, 2, _YUYV),
    'yuyv': (np.uint8, 2, _YUYV),
    **{f'bayer_{name}8': (np.uint8, 1, _demosaic(*places)) for name, places in _BAYER.items()},
}
ENCODINGS = tuple(_ENCODINGS)  # names of the encodings that are read
MILLIMETRES, FLOATS = '16UC1', '32FC1'  # encodings of depths
_DEPTH_UNITS_M = {MILLIMETRES: 1e-3, 'mono16': 1e-3, FLOATS: 1.0}
DEPTH_HEADER_BYTES = 12  # before the PNG of `compressedDepth`


def decode_image(raw: bytes, msgtype: str, limits: NodeConfig) -> tuple[Header, Pixels]:
    """Decode an image of one of `IMAGE_TYPES`: its header, and red, green and blue (H, W, 3)."""
    message = decode(raw, msgtype)
    header = validate_header(message.header, limits)
    if msgtype == COMPRESSED_IMAGE:
        return header, _decompress(message.data.tobytes())
    if message.encoding not in _ENCODINGS:
        raise InputError(f'encoding: {message.encoding!r}, expected one of {", ".join(ENCODINGS)}')
    number_type, channels, convert = _ENCODINGS[message.encoding]
    return header, np.ascontiguousarray(convert(_view_numbers(message, number_type, channels)).astype(np.uint8))


def decode_depth_image(raw: bytes, msgtype: str, limits: NodeConfig) -> tuple[Header, Depths, float]:
    """Decode a depth image of one of `IMAGE_TYPES`: header, depths along the optical axis, and their unit in m.

    Depths (H, W) are 0 or NaN where unknown. A CompressedImage is one of the transport `compressedDepth`.
    """
    message = decode(raw, msgtype)
    header = validate_header(message.header, limits)
    if msgtype == COMPRESSED_IMAGE:
        return header, *_decompress_depth(message.format, message.data.tobytes())
    if message.encoding not in _DEPTH_UNITS_M:
        raise InputError(f'encoding: {message.encoding!r}, expected one of {", ".join(_DEPTH_UNITS_M)}')
    depth: Depths
    if message.encoding == FLOATS:
        depth = np.asarray(_view_numbers(message, np.float32, 1)[..., 0], np.float64)
    else:
        depth = np.asarray(_view_numbers(message, np.uint16, 1)[..., 0], np.uint16)
    return header, depth, _DEPTH_UNITS_M[message.encoding]


def _view_numbers(message: Any, number_type: type[np.generic], channels: int) -> Numbers:
    number = np.dtype(number_type).newbyteorder('>' if message.is_bigendian else '<')
    height, width, step = int(message.height), int(message.width), int(message.step)
    row_bytes = width * channels * number.itemsize
    _check_size(width, height)
    if step < row_bytes:
        raise InputError(f'step: {step} bytes, less than a row of {width} pixels in {message.encoding}')
    if len(message.data) < step * (height - 1) + row_bytes:
        raise InputError(f'data: {len(message.data)} bytes, expected {step * height}')
    rows = np.lib.stride_tricks.as_strided(message.data, (height, row_bytes), (step, 1), writeable=False)
    return np.ascontiguousarray(rows).view(number).reshape(height, width, channels)


def _check_size(width: int, height: int) -> None:
    if not 0 < width * height <= MAX_IMAGE_PIXELS:
        raise InputError(f'width, height: {width} x {height} px')


def _decompress(data: bytes) -> Pixels:
    with _opening(data, 'JPEG', 'PNG') as picture:
        if picture.mode.startswith('I'):  # more than 8 bits of grey, which `convert` would cut off
            return np.asarray(_stretch_grey(_read_grey(picture)[..., None]).astype(np.uint8))
        return np.asarray(picture.convert('RGB'))


def _decompress_depth(kind: str, data: bytes) -> tuple[Depths, float]:
    """Read depths as compressed_depth_image_transport writes them: 12 bytes, of which 8 are A and B, and a PNG.

    Floats are A / (q - B), with q the numbers of the PNG.
    """
    encoding = kind.partition(';')[0].strip()
    if 'compressedDepth' not in kind or encoding not in _DEPTH_UNITS_M:
        expected = ' or '.join(f'{name}; compressedDepth' for name in (MILLIMETRES, FLOATS))
        raise InputError(f'format: {kind!r}, expected {expected}')
    with _opening(data[DEPTH_HEADER_BYTES:], 'PNG') as picture:
        depth = _read_grey(picture)
    if encoding == MILLIMETRES:
        return depth, _DEPTH_UNITS_M[encoding]
    a, b = np.frombuffer(data[4:DEPTH_HEADER_BYTES], '<f4').astype(float)
    return np.where(depth > b, a / np.where(depth > b, depth - b, 1.0), np.nan), _DEPTH_UNITS_M[encoding]


def _read_grey(picture: Pillow.Image) -> NDArray[np.uint16]:
    return np.clip(np.asarray(picture), 0, np.iinfo(np.uint16).max).astype(np.uint16)


@contextmanager
def _opening(data: bytes, *formats: str) -> Iterator[Pillow.Image]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', Pillow.DecompressionBombWarning)
            with Pillow.open(io.BytesIO(data), formats=formats) as picture:
                _check_size(*picture.size)
                yield picture
    except InputError:
        raise
    except Exception as error:  # the bytes may come from anywhere, so the reader may raise anything
        reason = f'not {" or ".join(formats)}' if isinstance(error, UnidentifiedImageError) else str(error)
        raise InputError(f'data: {reason}') from None
