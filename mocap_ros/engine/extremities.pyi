# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]

def collect_frame(
    p: int,
    frame: int,
    core: Array,
    camera: Array,
    lifted: Array | None,
    std: Array | None,
    rays: Array,
    weight: Array,
    other_rays: Array | None,
    other_weight: Array | None,
    out_lifted: Array,
    out_std: Array,
    out_rays: Array,
    out_weight: Array,
) -> None: ...

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
        self,
        states: Array,
        core: Array,
        lifted: Array,
        lifted_std: Array,
        rays: Array,
        weight: Array,
        noise: Array,
        stature: Array,
        steps: Array,
        is_steady: bool,
    ) -> None: ...
    def run(
        self,
        start: Array,
        core: Array,
        lifted: Array,
        lifted_std: Array,
        rays: Array,
        weight: Array,
        noise: float,
        stature: float,
        steps: Array,
        is_learning: bool,
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
