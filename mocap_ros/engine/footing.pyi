# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]

FOOTING: np.dtype[np.void]

def find_contacts(
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
    noise: float,
) -> Array: ...
def follow_contacts(
    footings: Array,
    times: Array,
    windows: Sequence[Any],
    frames: Sequence[int],
    core: Array,
    feet: Array,
    upward: Array,
    legs: Indices,
    others: Indices,
    noise: Array,
) -> None: ...
def advance(
    footings: Array,
    times: Array,
    noise: Array,
    core: Array,
    feet: Array,
    legs: Indices,
    ahead: Array | None = None,
) -> None: ...
def smooth(
    noise: float,
    times: Array,
    core: Array,
    feet: Array,
    contact: Array,
    legs: Indices,
    rounds: int,
    ahead: Array | None = None,
) -> Array: ...
def list_constants(noise: float, is_live: bool) -> Array: ...
