# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests, in the folders of the package; what several of them share is in `support`."""
