# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tracking of people in 3D, frame by frame: a sliding window and a solution for each person."""
