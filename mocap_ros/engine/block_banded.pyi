# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

class BlockCholesky:
    def __init__(
        self, blocks: Array, diagonal: Array, corners: Array, is_free: NDArray[np.bool_] | None = None
    ) -> None: ...
    def solve_lower(self, right: Array) -> Array: ...
    def solve_lower_transposed(self, right: Array) -> Array: ...
    def log_determinant(self) -> float: ...
