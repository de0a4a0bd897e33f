# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages as objects of rosbags, as others write them; those of a camera: CameraInfo, /tf and all images."""

import io
from typing import Any

import numpy as np
from PIL import Image
from rosbags.typesys.store import Typestore

from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode, pad, typestore
from mocap_ros.messages.imu import IMU
from mocap_ros.messages.plain import encode_plain
from mocap_ros.messages.transforms import StampedTransform, write_transforms
from mocap_ros.units import NS_PER_S


def camera_info(
    width: int = 640,
    height: int = 480,
    focal: float = 600.0,
    model: str = 'plumb_bob',
    d: tuple[float, ...] = (0.0,) * 5,
    p: tuple[float, ...] = (0.0,) * 12,
    binning: tuple[int, int] = (0, 0),
    region: tuple[int, int, int, int] = (0, 0, 0, 0),  # x, y, width and height in px
    centre: float = 0.5,  # principal point as a share of width and height
    frame_id: str = 'camera',
) -> bytes:
    x, y, region_width, region_height = region
    message = {
        'header': Header(0, frame_id),
        'height': height,
        'width': width,
        'distortion_model': model,
        'd': d,
        'k': (focal, 0, width * centre, 0, focal, height * centre, 0, 0, 1),
        'r': np.eye(3),
        'p': p,
        'binning_x': binning[0],
        'binning_y': binning[1],
        'roi': (x, y, region_height, region_width, False),
    }
    return encode_plain(message, CAMERA_INFO)


def make_ros1_header(store: Typestore, header: Any) -> Any:
    return store.types['std_msgs/msg/Header'](seq=7, stamp=header.stamp, frame_id=header.frame_id)


def encode_ros1_camera_info(store: Typestore, raw: bytes | None = None) -> bytes:
    """Return a CameraInfo with the header and the names of fields of ROS 1, in its encoding."""
    message = decode(raw or camera_info(), CAMERA_INFO)
    by_name = {name.lower(): value for name, value in vars(message).items()}
    fields = {name: by_name[name.lower()] for name, _ in store.fielddefs[CAMERA_INFO][1]}
    old = store.types[CAMERA_INFO](**{**fields, 'header': make_ros1_header(store, message.header)})
    return bytes(store.serialize_ros1(old, CAMERA_INFO))


def make_imu(header: Header, acceleration: Any, covariance: float = 0.0) -> bytes:
    """Return an Imu of an acceleration in m/s^2, without orientation; its covariance is -1 where it is none."""
    covariances = {'orientation_covariance': (-1.0, *(0.0,) * 8)}
    covariances['linear_acceleration_covariance'] = (covariance, *(0.0,) * 8)
    return encode_plain({'header': header, 'linear_acceleration': acceleration, **covariances}, IMU)


def make_transforms(*transforms: Any) -> bytes:
    """Return a TFMessage of (parent, child, stamp in ns, translation in m, and optionally a quaternion)."""
    return write_transforms([_list_fields(*t) for t in transforms])


def _list_fields(
    parent: str, child: str, stamp_ns: int, translation: Any, rotation: Any = (0, 0, 0, 1)
) -> StampedTransform:
    return Header(stamp_ns, parent), child, (*translation, *rotation)


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


def create_message(msgtype: str, **values: Any) -> Any:
    return typestore().types[msgtype](**values)


def create_header(header: Header) -> Any:
    seconds, nanoseconds = divmod(header.stamp_ns, NS_PER_S)
    stamp = create_message('builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds)
    return create_message('std_msgs/msg/Header', stamp=stamp, frame_id=header.frame_id)


def encode(message: Any, msgtype: str) -> bytes:
    return pad(bytes(typestore().serialize_cdr(message, msgtype)))
