# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Declare the parameters of a node."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import inf

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

from mocap_ros.config import Parameter, Value, suggest_parameter
from mocap_ros.errors import ConfigError

MAX_INTEGER = 2**31 - 1  # the bound of integer parameters without one; rclpy's ranges need both bounds
QOS_OVERRIDE_PREFIX = 'qos_overrides.'  # rclpy declares these parameters when the node subscribes


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
