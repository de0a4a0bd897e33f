# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of CameraInfo, /tf and /tf_static."""

from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.plain import encode_plain
from mocap_ros.messages.transforms import StampedTransform, write_transforms


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
) -> bytes:
    x, y, region_width, region_height = region
    message = {
        'header': Header(0, 'camera'),
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


SECOND_NS = 1_000_000_000  # ns in a second


def make_transforms(*transforms: Any) -> bytes:
    """Return a TFMessage of (parent, child, stamp in ns, translation in m, and optionally a quaternion)."""
    return write_transforms([_list_fields(*t) for t in transforms])


def _list_fields(
    parent: str, child: str, stamp_ns: int, translation: Any, rotation: Any = (0, 0, 0, 1)
) -> StampedTransform:
    return Header(stamp_ns, parent), child, (*translation, *rotation)
