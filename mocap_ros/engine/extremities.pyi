# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]

STATE: np.dtype[np.void]

def collect_evidence(
    core: Array, windows: Sequence[Any], frames: Sequence[int]
) -> tuple[Array, Array, Array, Array]: ...

class Body:
    def __init__(
        self,
        joints: Sequence[int],
        limbs: Indices,
        bends: Array,
        head_rest: Array,
        end_rest: Array,
        part_segments: Indices,
        part_of: Indices,
        size_of: Indices,
        template: Array,
        rest_std: Array,
        rest_memory_s: Array,
        size_std: Array,
    ) -> None: ...
    def follow(
        self, states: Array, evidence: tuple[Array, ...], stature: Array, times: Array, is_steady: bool
    ) -> None: ...
    def complete(
        self, states: Array, sizes: Array, motion: tuple[Array, ...], std: Array, root_covariance: Array
    ) -> tuple[Array, Array, Array, Array, Array, NDArray[np.bool_], Array]: ...
    def run(
        self, start: Array, evidence: tuple[Array, ...], stature: float, steps: Array, is_learning: bool
    ) -> tuple[Array, Array]: ...
    def finish(self, states: Array, weight: Array, stature: float) -> None: ...

def sum_derivatives(
    template: Array,
    turn: Array,
    size: float,
    origin: Array,
    lifted: Array,
    across: float,
    along: float,
    ray: Array,
    variance: float,
    share: float,
) -> tuple[Array, Array]: ...
