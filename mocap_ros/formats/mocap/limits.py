# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The limit on the positions that a motion-capture file may ask for."""

from __future__ import annotations

from mocap_ros.errors import InputError

# Positions of all joints in all frames, of some 100 bytes each with the rotations. An hour of 80 joints at 120 Hz
# has 35 million; a frame may take two bytes of a file, so the size of the file is no limit.
MAX_POSITIONS = 40_000_000


def check_position_count(frames: int, joints: int) -> None:
    """Check that the positions of all joints in all frames fit into the memory.

    Raises:
        InputError: there are more than `MAX_POSITIONS`.
    """
    if frames * joints > MAX_POSITIONS:
        raise InputError(f'{frames} frames of {joints} joints, more than {MAX_POSITIONS} positions')
