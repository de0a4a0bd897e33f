# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of other packages: their definitions, and the bodies of ROS4HRI; `messages/input_types.py` reads the others."""
