# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Convert between the node's ROS parameters and `Config`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from mocap_ros.config import Config, Parameter, parameters, suggest_parameter, with_values
from mocap_ros.errors import ConfigError

MAX_INTEGER = 2**31 - 1  # the bound of integer parameters without one; rclpy's ranges need both bounds
QOS_OVERRIDE_PREFIX = 'qos_overrides.'  # rclpy declares these parameters when the node subscribes


def declare_parameters(node: Node) -> Config:
    """Declare all parameters on a node, with ranges and descriptions, and return their values.

    Raises:
        ConfigError: A parameter was given a value that it cannot have; the error names the parameter.
    """
    try:
        given: dict[str, object] = {
            p.name: node.declare_parameter(p.name, p.default, _describe_parameter(p)).value for p in parameters()
        }
    except ParameterException as error:
        raise ConfigError(str(error)) from None
    return with_values(Config(), given)


def warn_of_unknown_parameters(node: Node, names: Sequence[str], listed_by: str) -> None:
    """Log a warning for each parameter that was given at the start and that is none of these names.

    Args:
        node: The node.
        names: Names of its parameters.
        listed_by: Command that lists them.
    """
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith(QOS_OVERRIDE_PREFIX):
            suggestion = suggest_parameter(name, names, listed_by)
            node.get_logger().warning(f'unknown parameter {name!r} has no effect; {suggestion}')


def select_config_values(changed: Sequence[RosParameter[Any]]) -> dict[str, object]:
    """Return the values, by name, of those changed parameters that belong to `Config`."""
    names = {p.name for p in parameters()}
    return {p.name: p.value for p in changed if p.name in names}


def _describe_parameter(p: Parameter) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter: description, range, choices and whether it is read-only.

    ROS would refuse a whole number for a real parameter, as in `-p tracker.window:=2`, unless the type may change.
    """
    descriptor = ParameterDescriptor(
        description=p.description,
        additional_constraints=f'one of {", ".join(p.choices)}' if p.choices else '',
        read_only=p.read_only,
        dynamic_typing=p.takes_numbers or p.kind is float,
    )
    if p.kind is float and (p.low is not None or p.high is not None):
        low = -sys.float_info.max if p.low is None else float(p.low)
        high = sys.float_info.max if p.high is None else float(p.high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    if p.kind is int and (p.low is not None or p.high is not None):
        low_integer = -MAX_INTEGER if p.low is None else int(p.low)
        high_integer = MAX_INTEGER if p.high is None else int(p.high)
        descriptor.integer_range = [IntegerRange(from_value=low_integer, to_value=high_integer, step=1)]
    return descriptor
