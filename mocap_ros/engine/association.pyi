# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

def measure_sizes(points: Array, weight: Array, min_size: float) -> Array: ...
def expect_people(
    people: Sequence[Any], stamp_ns: int, joints: int, max_moved_s: float, min_span_s: float, min_shared: int
) -> tuple[Array, Array]: ...
def measure_distances(
    expected: Array,
    known: Array,
    detected: Array,
    seen: Array,
    mirror: NDArray[np.int64],
    min_shared: int,
    min_size: float,
    few_shared: int,
    radius_offset: float,
) -> tuple[Array, Array]: ...
def choose_pairs(costs: Array) -> NDArray[np.int64]: ...
