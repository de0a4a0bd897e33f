# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Array32: TypeAlias = NDArray[np.float32]
Indices: TypeAlias = NDArray[np.int64]

def sample_joints(
    ago: Array,
    frame: int,
    times: Array,
    theta: Array,
    rotation: Array,
    roots: Array,
    mean: Array,
    components: Array,
    size: float,
) -> Array: ...
def filter_motion(filters: Array, times: Array, joints: Array, image_noise: Array) -> None: ...
def read_motion(
    filters: Array, times: Array, located: Array, left_hip: int, right_hip: int
) -> tuple[Array, Array, Array, Array]: ...
def build_inputs(
    velocity: Array, joints: Array, earlier: Array, axes: Array, spans: Array, mirror: Indices, hips: Indices
) -> Array: ...
def limit_correction(
    found: Array32,
    velocity: Array,
    std: Array,
    joints: Array,
    earlier: Array,
    axes: Array,
    needed: int,
    max_stds: float,
    spans: Array,
    mirror: Indices,
    hips: Indices,
) -> Array: ...
