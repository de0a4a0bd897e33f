# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Start rclpy with the arguments of a command line, and create nodes."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TypeVar

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.signals import SignalHandlerOptions

from mocap_ros.errors import ConfigError

AnyNode = TypeVar('AnyNode')


def initialise_rclpy(arguments: Sequence[str]) -> None:
    """Initialise rclpy without its own signal handlers.

    Raises:
        ConfigError: rclpy does not accept the arguments.
    """
    set_logger_level('rcl', LoggingSeverity.FATAL)  # rcl would log the reason of a failure as well
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = _drop_places(str(error)).removeprefix('failed to initialize rcl: ')
        raise ConfigError(f'ROS does not accept these arguments: {reason}') from None
    set_logger_level('rcl', LoggingSeverity.UNSET)


def create_node(node_class: Callable[[], AnyNode]) -> AnyNode:
    """Create a node.

    Raises:
        ConfigError: ROS refuses it, for instance because SROS2 gives it no permission.
    """
    try:
        return node_class()
    except rclpy_implementation.RCLError as error:
        raise ConfigError(f'ROS refuses to create the node: {_drop_places(str(error))}') from None


def _drop_places(reason: str) -> str:
    """Return an error of rcl without its places in the source code."""
    return re.sub(r', at \S+:\d+', '', reason)
