# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: write, read and recover MCAP files and rosbag2 bags."""
