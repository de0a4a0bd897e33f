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

    def __init__(
        self, counts: Sequence[int], mean: Array, arrays: Any, sigma: Array, has_lifted: bool
    ) -> None: ...
    def add(
        self,
        p: int,
        fixed_frames: int,
        share: float,
        alternations: int,
        focal: float,
        solver_focal: float,
        times: Array,
        rays: Array,
        weight: Array,
        camera: Array,
        lifted: Array | None,
        std: Array | None,
        theta: Array,
        rotation: Array,
        roots: Array,
        bone_lengths: Array,
    ) -> None: ...
    def finish(
        self,
        p: int,
        fixed_frames: int,
        focal: float,
        camera: Array,
        theta: Array,
        rotation: Array,
        roots: Array,
        bone_lengths: Array,
        residuals: Array,
        lifted_std: Array | None,
        new_theta: Array,
        new_rotation: Array,
        joints: Array,
        scale: Array,
        translation: Array,
        new_residuals: Array,
        stature_per_bone: Array,
        hidden_share: float,
    ) -> tuple[Array, Array, Array, Array, Array, float, float]: ...
