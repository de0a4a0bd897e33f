# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fuzz tests: bytes from strangers give a result or one clear error, in bounded memory and time."""
