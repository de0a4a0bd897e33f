# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readers and writers of files that are not bags."""
