# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The public Python API: NumPy arrays in, results out. `mocap_ros/__init__.py` exports it."""
