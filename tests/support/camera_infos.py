"""CameraInfo messages for tests."""

from __future__ import annotations

import numpy as np

from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import create_message, encode


def camera_info(
    width: int = 640,
    height: int = 480,
    focal: float = 600.0,
    model: str = 'plumb_bob',
    d: tuple[float, ...] = (0.0,) * 5,
    p: tuple[float, ...] = (0.0,) * 12,
) -> bytes:
    region = create_message(
        'sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    stamp = create_message('builtin_interfaces/msg/Time', sec=0, nanosec=0)
    message = create_message(
        CAMERA_INFO,
        header=create_message('std_msgs/msg/Header', stamp=stamp, frame_id='camera'),
        height=height,
        width=width,
        distortion_model=model,
        d=np.array(d),
        k=np.array([focal, 0, width / 2, 0, focal, height / 2, 0, 0, 1]),
        r=np.eye(3).ravel(),
        p=np.array(p),
        binning_x=0,
        binning_y=0,
        roi=region,
    )
    return encode(message, CAMERA_INFO)
