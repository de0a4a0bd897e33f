# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of other packages: their definitions, and the bodies of ROS4HRI (others: `input_types.py`)."""
