# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mocap_ros.engine.batch import Batch
from mocap_ros.engine.terms import Term

Array: TypeAlias = NDArray[np.float64]

class Ending(IntEnum):
    SINGULAR = -1
    MAX_ITERATIONS = 0
    CONVERGED = 1
    NO_LOWER_STEP = 2

SEARCH: np.dtype[np.void]

def end_step(search: NDArray[np.void], is_definite: bool, cost: float, tolerance: float) -> bool: ...

class JointProblem:
    batch: Batch
    terms: tuple[Term, ...]
    components: int
    frames: NDArray[np.void]
    searches: NDArray[np.void]
    diagonal: Array
    gradient: Array
    bone_vectors: Array
    coupling: Array

    def __init__(
        self, batch: Batch, model: Any, arrays: Any, terms: tuple[Term, ...], components: int
    ) -> None: ...
    @property
    def cost(self) -> Array: ...
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
    def read_camera_blocks(self) -> Array: ...
    def measure_residual(self) -> Array: ...
    def measure_squared_errors(self) -> Array: ...
    def measure_misfit(self) -> Array: ...
    def measure_joint_std(self) -> Array: ...
