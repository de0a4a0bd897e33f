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
def correct_velocity(
    velocity: Array,
    std: Array,
    joints: Array,
    earlier: Array,
    axes: Array,
    needed: int,
    spans: Array,
    mirror: Indices,
    hips: Indices,
    centre: Array32,
    scale: Array32,
    weight_0: Array32,
    bias_0: Array32,
    weight_1: Array32,
    bias_1: Array32,
) -> Array: ...
def add_correction(
    velocity: Array,
    std: Array,
    covariance: Array,
    correction: Array,
    hips: Indices,
    std_factor: float,
    correction_factor: float,
    root_factor: float,
) -> None: ...
def estimate_joint_std(
    posterior: Array,
    weight: Array,
    lifter_std: Array,
    noise: Array,
    seen_factor: float,
    inferred_factor: float,
    floor: float,
    lifter_seen_factor: float,
    lifter_inferred_factor: float,
    noise_factor: float,
) -> Array: ...
def estimate_root_covariance(
    joints: Array,
    std: Array,
    sizes: Array,
    left_hip: int,
    right_hip: int,
    factor: float,
    across: float,
    along: float,
) -> Array: ...
