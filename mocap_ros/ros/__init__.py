# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the package in ROS 2: the lifecycle node and the player. Only this package imports rclpy."""
