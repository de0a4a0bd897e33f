# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mocap_ros.engine.joint import JointProblem

Array: TypeAlias = NDArray[np.float64]
Values: TypeAlias = tuple[Array, float, Array, Array, Array]

REPETITION: tuple[float, float]

class Point:
    coefficients: Array
    omega: float
    rotation: Array
    log_scale: Array
    translation: Array

    @property
    def values(self) -> Values: ...

class PeriodicProblem:
    body: JointProblem
    point: Point
    cost: Array
    damping: float
    noise_ratio: float
    status: int
    series_matrix: Array
    series_prior: Array
    series_gradient: Array
    mixed_matrix: Array
    camera_image: Array
    camera_prior: Array
    camera_coupling: Array
    camera_gradient: Array
    series_step: Array
    camera_step: Array

    def __init__(
        self,
        body: JointProblem,
        score: Array,
        robust_scale: float,
        times: Array,
        prior: Array,
        level_weight: float,
        movement: Array,
        start: Values,
        noise_ratio: float,
        settle_steps: int = 0,
    ) -> None: ...
    def set_noise(self, ratio: float) -> None: ...
    def restart(self) -> None: ...
    def estimate_noise(self) -> float: ...
    def count_effective_parameters(self) -> float: ...
    def camera_log_determinant_ratio(self) -> float: ...
    def begin(self, damping: float) -> None: ...
    def update_equations(self) -> None: ...
    def solve(self, damping: float) -> bool: ...
    def try_steps(self, tolerance: float) -> tuple[int, int]: ...

def fit_series(times: Array, theta: Array, frequencies: Array, ridge: Array) -> tuple[Array, Array]: ...
def measure_repetition(times: Array, theta: Array, cadence: float) -> float: ...
