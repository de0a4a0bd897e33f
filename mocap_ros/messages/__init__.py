# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""ROS messages to and from CDR bytes, with one file for each message; no ROS installation is needed."""
