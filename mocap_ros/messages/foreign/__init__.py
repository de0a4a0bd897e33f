# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readers of the messages of other packages' detectors, with one file for each package."""
