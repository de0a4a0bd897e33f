# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]

def measure_depths(
    surface: Array,
    rays: Array,
    axes: Array,
    poses: Array,
    std: Array,
    expected: Array,
    prior: float,
    thickness: Array,
    segments: Indices,
    radii: Array,
) -> tuple[Array, Array, Array, Array, Array]: ...
