# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]

VELOCITY_TIME_S: float
SWAPPED_PARTS: NDArray[np.bool_]

def continue_paths(
    path_cost: Array,
    path_states: NDArray[np.int8],
    path_joints: Array,
    time_s: float,
    points: Array,
    weight: Array,
    body_size: float,
    mirror: Indices,
    part: Indices,
    upper: Indices,
    lower: Indices,
) -> tuple[Array, NDArray[np.int8], Array, NDArray[np.bool_]]: ...
def exchange_sides(
    points: Array, weight: Array, is_swapped: NDArray[np.uint8], mirror: Indices, part: Indices
) -> tuple[Array, Array]: ...
