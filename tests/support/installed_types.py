# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Message types that count as installed, as rclpy describes them, without a ROS that has them."""

from __future__ import annotations

from typing import Any

import pytest
from rosbags.typesys.store import Typestore

from mocap_ros.ros import message_types

Fields = dict[str, dict[str, str]]  # rclpy's descriptions of fields, by type and name
RCLPY_NAMES = {'bool': 'boolean', 'byte': 'octet', 'float32': 'float', 'float64': 'double'}
DEFINITION_RULE = '=' * 80  # line between the types in a definition

# All types that MarkerArray contains in ROS 2 Foxy.
MARKER_TYPES = (
    'visualization_msgs/msg/MarkerArray',
    'visualization_msgs/msg/Marker',
    'std_msgs/msg/Header',
    'std_msgs/msg/ColorRGBA',
    'builtin_interfaces/msg/Time',
    'builtin_interfaces/msg/Duration',
    'geometry_msgs/msg/Pose',
    'geometry_msgs/msg/Point',
    'geometry_msgs/msg/Quaternion',
    'geometry_msgs/msg/Vector3',
)


def replace_installed_types(monkeypatch: pytest.MonkeyPatch, installed: Fields) -> None:
    """Let these types, and no others, count as installed."""

    def load_installed_class(msgtype: str) -> Any:
        return type('Installed', (), {'get_fields_and_field_types': staticmethod(lambda: installed[msgtype])})

    monkeypatch.setattr(message_types, 'load_interface_class', load_installed_class)


def describe_as_rclpy(store: Typestore, *msgtypes: str) -> Fields:
    """Describe the fields of types, which have no bounds, as rclpy does."""
    described: Fields = {}
    for msgtype in msgtypes:
        text = store.generate_msgdef(msgtype, ros_version=2)[0].partition(DEFINITION_RULE)[0]
        lines = [line.split() for line in text.splitlines()]
        described[msgtype] = {field[1]: _describe_type(field[0]) for field in lines if len(field) == 2}
    return described


def _describe_type(kind: str) -> str:
    element, bracket, length = kind.rstrip(']').partition('[')
    name = RCLPY_NAMES.get(element, element).replace('/msg/', '/')
    if not bracket:
        return name
    return f'{name}[{length}]' if length else f'sequence<{name}>'
