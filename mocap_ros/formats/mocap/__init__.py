# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readers of motion-capture files, for training."""
