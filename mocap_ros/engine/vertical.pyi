# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

def add_frame(
    direction: Array,
    sums: tuple[float, float, float, float, float],
    faded: float,
    step_s: float,
    sign: float,
    level_deg: float,
    last_level_deg: float,
    outlier_deg: float,
    min_standing: float,
    upward: Array,
    standing: Array,
    shown: Array,
) -> tuple[Array, float, float, float, float, float]: ...
def judge(
    found: Array,
    sums: Array,
    sign: float,
    is_turned: bool,
    level_pitch_deg: float,
    shrinkage: float,
    standing_share: float,
    usual_deg: float,
    body_deg: float,
    second_deg: float,
    max_deg: float,
    askew_deg: float,
) -> tuple[Array, Array]: ...
def turn_poses(
    joints: Array,
    std: Array,
    cameras: Array,
    upward: Array,
    standing: Array,
    vertical: Array,
    vertical_std: Array,
    core: int,
    level_deg: float,
    last_level_deg: float,
) -> Array: ...
def find_stances(
    joints: Array,
    cameras: Array,
    masses: Array,
    sides: NDArray[np.int64],
    hands: NDArray[np.int64],
    neck: int,
    pelvis: int,
    head: int,
    support_ahead: float,
    hanging_share: float,
    standing_deg: float,
    seated_deg: float,
    min_length: float,
) -> tuple[Array, Array]: ...
