# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the nodes of this package share: parameters, start and end, transitions, and how failures are reported."""

from __future__ import annotations

import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from math import inf
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from mocap_ros.config import Parameter, Value, suggest_parameter
from mocap_ros.errors import ConfigError, MocapError
from mocap_ros.ros.throttled_log import TracebackLog

MAX_STANDSTILL_S = 5.0  # s; players and simulators send /clock from their start on
SPIN_SECONDS = 0.1  # s; bounds the delay between a signal and the end of the node
MAX_INTEGER = 2**31 - 1  # the bound of integer parameters without one; rclpy's ranges need both bounds
QOS_OVERRIDE_PREFIX = 'qos_overrides.'  # rclpy declares these parameters when the node subscribes


class ManagedNode(LifecycleNode):
    """A lifecycle node of which a subclass says what is made when it is configured, and what runs while active.

    Where that fails, as by the value of a parameter, `failure` says why, and `run_node` ends the node.
    """

    failure: MocapError | None = None

    def configure(self) -> None:
        """Make what the node needs; an error ends the node."""
        raise NotImplementedError

    def clean_up(self) -> None:
        """Discard what `configure` made, also where it failed half-way or was not called."""
        raise NotImplementedError

    def start_run(self) -> None:
        """Begin to work; an error ends the node."""
        raise NotImplementedError

    def stop_run(self) -> None:
        """End the work, also where `start_run` failed half-way or was not called."""
        raise NotImplementedError

    has_autostart = True  # whether `start` does anything

    def start(self) -> None:
        """Configure and activate the node, unless it waits for somebody else to do so."""
        if self.has_autostart and self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def close(self) -> None:
        """Stop and clean up, in any state."""
        self.stop_run()
        self.clean_up()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure the node."""
        try:
            self.configure()
        except Exception as error:
            self._fail(error)
            self.clean_up()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the publishers, then start the run."""
        result = super().on_activate(state)
        try:
            self.start_run()
        except Exception as error:
            self._fail(error)
            self.stop_run()
            super().on_deactivate(state)
            return TransitionCallbackReturn.FAILURE
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the run, which still publishes, then deactivate the publishers."""
        self.stop_run()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        result = super().on_cleanup(state)
        self.clean_up()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and clean up."""
        self.stop_run()
        result = super().on_shutdown(state)
        self.clean_up()
        return result

    on_error = on_shutdown  # afterwards the node can be configured again

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> object:
        """Create a timer of the steady clock, whatever the time of a simulation is."""
        return self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _fail(self, error: Exception) -> None:
        self.failure = error if isinstance(error, MocapError) else MocapError(f'{type(error).__name__}: {error}')


class ClockMonitor:
    """Observer of the time of a node, which stands still where `use_sim_time` is set and nothing sends /clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._moved_s = time.monotonic()

    def check(self) -> None:
        """Log a warning once the time has been 0 for `MAX_STANDSTILL_S`."""
        clock = self._node.get_clock()
        now_s = time.monotonic()
        if not clock.ros_time_is_active or clock.now().nanoseconds:
            self._moved_s = now_s
        elif now_s - self._moved_s > MAX_STANDSTILL_S:
            self._moved_s = inf
            self._node.get_logger().warning(
                f'use_sim_time is set, but nothing has arrived on /clock for {MAX_STANDSTILL_S:g} s; start what '
                'sends it (`mocap-ros play --clock`, a simulator), or leave use_sim_time out'
            )


def run_node(arguments: Sequence[str], node_class: Callable[[], Any]) -> None:
    """Run a node, with methods `start` and `close`, until SIGINT or SIGTERM; rclpy parses the arguments.

    Its `failure`, if it has one, is raised.
    """
    stop = threading.Event()

    def request_stop(*_: object) -> None:
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, request_stop)
    _initialise_rclpy(arguments)
    with ExitStack() as stack:
        stack.callback(rclpy.shutdown)
        executor = SingleThreadedExecutor()
        node = create_node(node_class)
        tracebacks = TracebackLog(node.get_logger())
        executor.add_node(node)
        for end in (node.destroy_node, executor.shutdown, node.close):  # called last to first
            stack.callback(end)
        clock = ClockMonitor(node)
        node.start()
        while not stop.is_set():
            if failure := getattr(node, 'failure', None):
                raise failure
            try:
                clock.check()
                executor.spin_once(timeout_sec=SPIN_SECONDS)
            except ExternalShutdownException:
                raise
            except Exception:  # rclpy raises some for messages that anyone can send, as of a parameter's type
                tracebacks.report(traceback.format_exc())


def _initialise_rclpy(arguments: Sequence[str]) -> None:
    set_logger_level('rcl', LoggingSeverity.FATAL)  # rcl would log the reason of a failure as well
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = _drop_places(str(error)).removeprefix('failed to initialize rcl: ')
        raise ConfigError(f'ROS does not accept these arguments: {reason}') from None
    set_logger_level('rcl', LoggingSeverity.UNSET)


def create_node(node_class: Callable[[], Any]) -> Any:
    """Create a node; a ConfigError says why ROS refuses it, for instance because SROS2 gives it no permission."""
    try:
        return node_class()
    except rclpy_implementation.RCLError as error:
        raise ConfigError(f'ROS refuses to create the node: {_drop_places(str(error))}') from None


def _drop_places(reason: str) -> str:
    return re.sub(r', at \S+:\d+', '', reason)


def declare_parameters(node: Node, declared: Sequence[Parameter], listed_by: str) -> dict[str, Value]:
    """Declare parameters with ranges and descriptions, warn of unknown ones, and return the values by name."""
    try:
        values = {
            p.name: p.check(node.declare_parameter(p.name, p.default, _describe_parameter(p)).value)
            for p in declared
        }
    except ParameterException as error:
        raise ConfigError(str(error)) from None
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith(QOS_OVERRIDE_PREFIX):
            suggestion = suggest_parameter(name, values, listed_by)
            node.get_logger().warning(f'unknown parameter {name!r} has no effect; {suggestion}')
    return values


def _describe_parameter(p: Parameter) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter.

    ROS would refuse a whole number for a real parameter, as in `-p tracker.window:=2`, unless the type may change.
    """
    descriptor = ParameterDescriptor(
        description=p.description,
        additional_constraints=f'one of {", ".join(p.choices)}' if p.choices else '',
        read_only=p.read_only,
        dynamic_typing=p.takes_numbers or p.kind is float,
    )
    if p.kind is float and (p.low, p.high) != (-inf, inf):
        limits = max(float(p.low), -sys.float_info.max), min(float(p.high), sys.float_info.max)
        descriptor.floating_point_range = [FloatingPointRange(from_value=limits[0], to_value=limits[1])]
    elif p.kind is int:
        low, high = int(max(p.low, -MAX_INTEGER)), int(min(p.high, MAX_INTEGER))
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
    return descriptor
