# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Array32: TypeAlias = NDArray[np.float32]
Indices: TypeAlias = NDArray[np.int64]
Codes: TypeAlias = NDArray[Any]  # of 8 or 16 bits

def sample_histories(
    people: Sequence[tuple[Array, Sequence[int], Array, Sequence[tuple[Array, Array]]]],
    joints: int,
    slots: Array,
    max_gap_s: float,
    tolerance_s: float,
) -> tuple[Array, Array, Array]: ...
def encode(
    points: Array,
    weight: Array,
    focal: Array,
    upward: Array,
    mirror: Indices,
    core: int,
    turns_cameras: bool,
    images: int,
) -> tuple[Array32, Array, Array, Array]: ...
def evaluate(
    features: Array32,
    first: Codes,
    first_scales: Array32,
    hidden: Codes,
    hidden_scales: Array32,
    last: Codes,
    last_scales: Array32,
    biases: Array32,
    last_bias: Array32,
) -> Array32: ...
def lift(
    points: Array,
    weight: Array,
    focal: Array,
    upward: Array,
    network: Any,
    mirror: Indices,
    core: int,
    min_log_std: float,
    max_log_std: float,
) -> tuple[Array, Array]: ...
