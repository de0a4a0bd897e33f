# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

REPETITION: tuple[float, float]

def assemble(
    diagonal: Array, gradient: Array, bone_vectors: Array, vertical: Array, terms: Array, slopes: Array
) -> tuple[Array, Array, Array, Array, Array]: ...
def solve_step(
    matrix: Array,
    added: Array,
    gradient: Array,
    mixed: Array,
    blocks: Array,
    coupling: Array,
    camera_gradient: Array,
) -> tuple[Array, Array] | None: ...
def compute_trace_of_solved(matrix: Array, added: Array, diagonal: Array) -> float: ...
def measure_repetition(times: Array, theta: Array, cadence: float) -> float: ...
