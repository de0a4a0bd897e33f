# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Start rclpy with the arguments of a command line, create nodes, and run them."""

from __future__ import annotations

import re
import signal
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.signals import SignalHandlerOptions

from mocap_ros.compiled.kernel import is_compiling
from mocap_ros.errors import ConfigError
from mocap_ros.ros.throttled_log import Logger, TracebackLog

SPIN_SECONDS = 0.1  # s; bounds the delay between a signal and the end of the node


def run_node(arguments: Sequence[str], node_class: Callable[[], Any]) -> None:
    """Run a node until SIGINT or SIGTERM.

    Args:
        arguments: Arguments of the command line, which rclpy parses.
        node_class: Class of the node, with methods `start` and `close`.

    Raises:
        MocapError: An argument or a parameter is wrong, or the node cannot use a file.
    """
    stop = threading.Event()

    def request_stop(*_: object) -> None:
        stop.set()
        if is_compiling():  # in this thread, while the node is configured; nobody should wait for that
            raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, request_stop)
    initialise_rclpy(arguments)
    executor = SingleThreadedExecutor()
    try:
        node = create_node(node_class)
        executor.add_node(node)
        try:
            node.start()
            spin_until(stop, executor, node.get_logger())
        finally:
            try:
                node.close()
            finally:
                executor.shutdown()
                node.destroy_node()
    finally:
        rclpy.shutdown()


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


def create_node(node_class: Callable[[], Any]) -> Any:
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
