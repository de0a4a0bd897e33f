# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]

def follow_contacts(
    log_odds: Array,
    times: Array,
    rays: Array,
    weight: Array,
    other_rays: Array,
    other_weight: Array,
    core: Array,
    feet: Array,
    upward: Array,
    legs: Indices,
    others: Indices,
    numbers: Array,
) -> Array: ...
def begin() -> Array: ...
def advance(
    memory: Array, numbers: Array, step_s: float, core: Array, feet: Array, log_odds: Array, legs: Indices
) -> Array: ...
def smooth(
    numbers: Array, times: Array, core: Array, feet: Array, contact: Array, legs: Indices, rounds: int
) -> Array: ...
