# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]

DAMPINGS: tuple[float, float, float, float]

class JointProblem:
    diagonal: Array
    gradient: Array
    bone_vectors: Array
    coupling: Array
    cost: Array
    iterations: Ints
    status: Ints

    def __init__(self, objective: Any, arrays: Any) -> None: ...
    def weigh(self, noise_ratio: Array, factors: Array) -> None: ...
    def start(
        self,
        theta: Array,
        rotation: Array,
        log_scale: Array,
        translation: Array,
        settle_steps: int = 0,
        at_reference: bool = False,
    ) -> None: ...
    def begin(self, damping: float) -> None: ...
    def update_equations(self) -> None: ...
    def try_steps(self, tolerance: float) -> tuple[int, int]: ...
    def measure_misfit(self) -> Array: ...
    def measure_least_noise(self, growth: Array | None = None) -> Array: ...
    def measure_joint_std(self) -> Array: ...
    def describe(self, units: Array) -> tuple[Array, Array, Array, Array]: ...
    def read(self, name: str) -> Array: ...

def fit_lifted_poses(
    joints: Array, std: Array, basis: Array, mean: Array, sigma: Array, alternations: int
) -> tuple[Array, Array, Array]: ...
