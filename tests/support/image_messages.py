# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fields of image messages in every encoding."""

import io
from typing import Any

import numpy as np
from PIL import Image

# Red, green and blue of full-range YCbCr (ITU-R BT.601) without the offset of 128 of the last two rows.
YUV_BY_RGB = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])
BAYER = {'rggb': (0, 1, 1, 2), 'bggr': (2, 1, 1, 0), 'gbrg': (1, 2, 0, 1), 'grbg': (1, 0, 2, 1)}  # by rows


def arrange(image: np.ndarray, encoding: str) -> np.ndarray:
    """Return an image (H, W, 3) of red, green and blue as the numbers (H, W * channels) of an encoding."""
    height = len(image)
    if encoding.startswith('bayer_'):
        plane = np.zeros(image.shape[:2], np.uint8)
        for place, channel in enumerate(BAYER[encoding[len('bayer_') : -1]]):
            row, column = divmod(place, 2)
            plane[row::2, column::2] = image[row::2, column::2, channel]
        return plane
    if encoding in ('yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv'):
        y, u, v = np.moveaxis(image @ YUV_BY_RGB.T, -1, 0)
        u, v = ((c[:, ::2] + c[:, 1::2]) / 2 + 128 for c in (u, v))
        first, second = y[:, ::2], y[:, 1::2]
        order = [u, first, v, second] if encoding in ('yuv422', 'uyvy') else [first, u, second, v]
        return np.clip(np.round(np.stack(order, axis=-1)), 0, 255).astype(np.uint8).reshape(height, -1)
    if encoding in ('mono8', '8UC1', 'mono16', '16UC1'):
        grey = image.mean(axis=-1).round()
        return grey.astype(np.uint8) if encoding in ('mono8', '8UC1') else (grey * 16).astype(np.uint16)
    is_blue_first = encoding.startswith(('bgr', '8U'))
    values = image[..., ::-1] if is_blue_first else image
    if encoding in ('rgba8', 'bgra8', '8UC4'):
        values = np.concatenate([values, np.full_like(values[..., :1], 77)], axis=-1)
    if encoding.endswith('16'):
        values = values.astype(np.uint16) * 256 + 13
    return values.reshape(height, -1)


def encode_pixels(
    image: np.ndarray, encoding: str, padding: int = 0, is_bigendian: bool = False
) -> dict[str, Any]:
    """Return the fields of a sensor_msgs/Image, whose rows have `padding` bytes at their end."""
    values = arrange(image, encoding)
    rows = values.astype(values.dtype.newbyteorder('>' if is_bigendian else '<')).view(np.uint8)
    rows = np.concatenate([rows, np.full((len(rows), padding), 99, np.uint8)], axis=1)
    return {
        'height': image.shape[0],
        'width': image.shape[1],
        'encoding': encoding,
        'is_bigendian': int(is_bigendian),
        'step': rows.shape[1],
        'data': rows.tobytes(),
    }


def make_compressed(image: np.ndarray, kind: str) -> dict[str, Any]:
    """Return the fields of a sensor_msgs/CompressedImage of the kind PNG or JPEG."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, kind, quality=95)
    return {'format': f'rgb8; {kind.lower()} compressed', 'data': file.getvalue()}
