# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings as a whole: files in, people out."""
