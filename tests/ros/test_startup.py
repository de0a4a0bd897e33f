# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A node that ROS refuses ends with one line."""

from __future__ import annotations

import pytest

from mocap_ros.errors import ConfigError

pytest.importorskip('rclpy')
pytestmark = pytest.mark.ros


def test_a_refused_node_is_reported_in_one_line() -> None:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    from mocap_ros.ros.nodes import create_node

    def refuse() -> None:
        raise rclpy_implementation.RCLError('no permission\nfor it, at /a/b.cpp:4, at /c.c:24')

    with pytest.raises(ConfigError, match=r'^ROS refuses to create the node: no permission for it$'):
        create_node(refuse)
