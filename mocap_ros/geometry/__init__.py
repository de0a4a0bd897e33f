# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations, lens distortion and camera models; nothing here depends on the human body."""
