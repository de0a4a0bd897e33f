# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trained models and their files: base poses, lifter, motion predictor, velocity correction; joint deviations."""
