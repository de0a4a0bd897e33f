# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

def add_frame(
    direction: Array,
    weight: float,
    step_s: float,
    sign: float,
    level_deg: float,
    last_level_deg: float,
    outlier_deg: float,
    min_standing: float,
    upward: Array,
    standing: Array,
) -> tuple[Array, float, float, float, float, float]: ...
def turn_poses(
    joints: Array,
    std: Array,
    upward: Array,
    vertical: Array,
    vertical_std: Array,
    standing: Array,
    core: int,
    level_deg: float,
    last_level_deg: float,
) -> Array: ...
def find_upward(
    joints: Array,
    masses: Array,
    sides: NDArray[np.int64],
    neck: int,
    pelvis: int,
    support_ahead: float,
    min_length: float,
) -> Array: ...
def find_standing(
    joints: Array,
    sides: NDArray[np.int64],
    neck: int,
    pelvis: int,
    min_length: float,
    hands: NDArray[np.int64],
    head: int,
    hanging_share: float,
    standing_deg: float,
    seated_deg: float,
) -> Array: ...
