# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Start rclpy with the arguments of a command line, create nodes, and run them."""

from __future__ import annotations

import re
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.signals import SignalHandlerOptions

from mocap_ros.errors import ConfigError
from mocap_ros.ros.throttled_log import Logger, TracebackLog

SPIN_SECONDS = 0.1  # s; bounds the delay between a signal and the end of the node

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


def spin_until(stop: threading.Event, executor: Any, logger: Logger) -> None:
    """Run the callbacks of an executor until an event is set.

    An error in a callback is logged, and the next callbacks run: rclpy raises errors for some messages that anyone
    can send, such as a parameter of an unknown type or a time that is negative.

    Args:
        stop: The event.
        executor: The executor with its nodes.
        logger: Logger for errors.

    Raises:
        ExternalShutdownException: The context was shut down.
    """
    tracebacks = TracebackLog(logger)
    while not stop.is_set():
        _spin_once(executor, tracebacks)


def _spin_once(executor: Any, tracebacks: TracebackLog) -> None:
    try:
        executor.spin_once(timeout_sec=SPIN_SECONDS)
    except ExternalShutdownException:
        raise
    except Exception:
        tracebacks.report(traceback.format_exc())


def _drop_places(reason: str) -> str:
    """Return an error of rcl without its places in the source code."""
    return re.sub(r', at \S+:\d+', '', reason)
