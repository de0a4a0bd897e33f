# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One whole recording at a time."""
