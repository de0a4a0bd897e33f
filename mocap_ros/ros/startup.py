"""Start rclpy with the arguments of a command line."""

from __future__ import annotations

import re
from collections.abc import Sequence

import rclpy
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.signals import SignalHandlerOptions

from mocap_ros.errors import ConfigError


def initialise_rclpy(arguments: Sequence[str]) -> None:
    """Initialise rclpy without its own signal handlers.

    Raises:
        ConfigError: rclpy does not accept the arguments.
    """
    set_logger_level('rcl', LoggingSeverity.FATAL)  # rcl would log the reason of a failure as well
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = re.sub(r', at \S+:\d+', '', str(error).removeprefix('failed to initialize rcl: '))
        raise ConfigError(f'ROS does not accept these arguments: {reason}') from None
    set_logger_level('rcl', LoggingSeverity.UNSET)
