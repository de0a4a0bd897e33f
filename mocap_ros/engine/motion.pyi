# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Array32: TypeAlias = NDArray[np.float32]
Indices: TypeAlias = NDArray[np.int64]

MOTION: np.dtype[np.void]

VARIANCE_ACROSS: float
VARIANCE_ALONG: float

def sample_joints(
    ago: Array, frames: Sequence[int], windows: Sequence[Any], solutions: Sequence[Any]
) -> Array: ...
def filter_motion(
    filters: Array, times: Array, located: Array, image_noise: Array, hips: Indices, is_steady: bool
) -> tuple[Array, Array, Array, Array]: ...
def build_inputs(past: tuple[Array, ...], spans: Array, mirror: Indices, hips: Indices) -> Array: ...
def correct_velocity(
    layers: Sequence[Array32],
    past: tuple[Array, ...],
    covariance: Array,
    limit: float,
    needed: int,
    max_stds: float,
    spans: Array,
    mirror: Indices,
    hips: Indices,
) -> None: ...
def describe_cores(
    posterior: Array, evidence: Any, joints: Array, sizes: Array, shifts: Array, hips: Indices
) -> tuple[Array, Array]: ...
def measure_stature(lengths: Array, stature_per_bone: Array) -> float: ...
