"""Message and service classes of rclpy by name, found at run time."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from mocap_ros.errors import ConfigError


def interface_class(kind: str) -> Any:
    """The class of a type such as `sensor_msgs/msg/CameraInfo` or `std_srvs/srv/Trigger`.

    Raises:
        ConfigError: its package is not installed, or has no such type.
    """
    module, _, name = kind.rpartition('/')
    try:
        return getattr(import_module(module.replace('/', '.')), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f'type {kind} is not installed ({error})') from None
