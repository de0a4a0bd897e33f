# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Variants of the solvers that only the experiments with the paper use."""
