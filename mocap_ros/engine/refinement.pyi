# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]

class NewestFrames:
    times: Array
    starts: Ints
    counts: Ints
    image: Array
    score: Array
    focal: Array
    is_free: NDArray[np.bool_]
    lifted: Array
    precision: Array
    earlier_lengths: Array
    earlier_frames: Ints
    theta: Array
    rotation: Array
    log_scale: Array
    translation: Array
    units: Array
    growth: Array
    factors: Array

    def __init__(
        self, counts: Sequence[int], mean: Array, arrays: Any, sigma: Array, has_lifted: bool
    ) -> None: ...
    def add(
        self,
        p: int,
        fixed_frames: int,
        share: float,
        alternations: int,
        observed: Any,
        solution: Any,
    ) -> None: ...
    def finish(
        self,
        fixed_frames: Sequence[int],
        observed: Sequence[Any],
        solutions: Sequence[Any],
        theta: Array,
        rotation: Array,
        joints: Array,
        scale: Array,
        translation: Array,
        residuals: Array,
        stature_per_bone: Array,
        hidden_share: float,
    ) -> list[tuple[Array, Array, Array, Array, Array, float, float]]: ...
