# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

class PoseFit:
    def __init__(self, model: Any, arrays: Any, alternations: int) -> None: ...
    def fit_all(self, joints: Array, variances: Array) -> tuple[Array, Array, Array]: ...
