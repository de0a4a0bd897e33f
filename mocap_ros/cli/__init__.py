# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command `mocap-ros`, with one module for each subcommand."""
