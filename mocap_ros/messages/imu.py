# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/Imu: the accelerations of a camera or a robot."""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import Header, decode_input, validate_header

IMU = 'sensor_msgs/msg/Imu'


def decode_acceleration(raw: bytes, limits: NodeConfig) -> tuple[Header, Array | None]:
    """Decode the header and the acceleration (3,) in m/s^2; None where the message says that it has none."""
    message = decode_input(raw, IMU)
    header, values = validate_header(message.header, limits), message.linear_acceleration
    if message.linear_acceleration_covariance[0] == -1:
        return header, None
    acceleration = np.array([values.x, values.y, values.z])
    if not np.isfinite(acceleration).all():
        raise InputError(f'linear_acceleration: {values.x:g}, {values.y:g}, {values.z:g} is not finite')
    return header, acceleration
