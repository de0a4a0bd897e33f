# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

MIN_TIME_STEP_S: float

class Batch:
    frames: NDArray[np.void]
    sequences: NDArray[np.void]
    theta: Array
    rotation: Array
    log_scale: Array
    has_lifted: bool

    def __init__(self, counts: Sequence[int] | NDArray[np.integer], components: int, has_lifted: bool) -> None: ...
    def measure_window(self, p: int, window: Any, unit: float) -> None: ...
    def measure_least_noise(self) -> None: ...
