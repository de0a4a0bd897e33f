# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Units that several folders convert."""

NS_PER_S = 1_000_000_000  # ns/s; stamps are whole nanoseconds, times in the mathematics are seconds
