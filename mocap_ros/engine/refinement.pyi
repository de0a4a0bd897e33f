# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mocap_ros.engine.batch import Batch
from mocap_ros.engine.lifted_start import PoseFit

Array: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]

def add_newest(
    batch: Batch, p: int, fixed_frames: int, share: float, observed: Any, solution: Any, pose_fit: PoseFit
) -> None: ...
def finish_newest(
    batch: Batch,
    states: NDArray[np.void],
    squared_errors: Array,
    fixed_frames: Sequence[int],
    observed: Sequence[Any],
    solutions: Sequence[Any],
    stature_per_bone: Array,
    parents: Ints,
    children: Ints,
    hidden_share: float,
) -> list[tuple[Array, Array, Array, Array, Array, float, float]]: ...
