"""Message classes of rclpy by name, found at run time."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from mocap_ros.errors import ConfigError


def message_class(msgtype: str) -> Any:
    """The class of a type such as `sensor_msgs/msg/CameraInfo`.

    Raises:
        ConfigError: its package is not installed, or has no such message.
    """
    package, _, name = msgtype.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f'message type {msgtype} is not installed ({error})') from None
