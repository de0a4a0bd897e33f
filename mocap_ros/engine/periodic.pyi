# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

REPETITION: tuple[float, float]

class StepSolver:
    def __init__(self, frames: int, unknowns: int) -> None: ...
    def solve(
        self,
        damping: float,
        matrix: Array,
        prior: Array,
        mixed: Array,
        blocks: Array,
        coupling: Array,
        gradient: Array,
        camera_gradient: Array,
    ) -> tuple[Array, Array] | None: ...

def evaluate(
    times: Array, omega: float, coefficients: Array, rotation: Array, terms: Array
) -> tuple[Array, Array]: ...
def assemble(
    terms: Array,
    slopes: Array,
    rotation: Array,
    diagonal: Array,
    cameras: Array,
    gradient: Array,
    bone_vectors: Array,
    out: Array,
    out_gradient: Array,
    mixed: Array,
) -> None: ...
def count_effective_parameters(matrix: Array, prior: Array, image: Array, blocks: Array) -> float: ...
def turn_rotations(vectors: Array, rotations: Array) -> Array: ...
def measure_repetition(times: Array, theta: Array, cadence: float) -> float: ...
