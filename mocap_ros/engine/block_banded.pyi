# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

class BlockCholesky:
    """Cholesky factor L of a symmetric block-banded matrix B of F frames with n unknowns each.

    Args:
        blocks: (F, n, n) blocks on the diagonal; their lower triangles are read.
        diagonal: (F, D, n) diagonals of the blocks in the rows of frame t + d + 1 and the columns of frame t.
        corners: (F, D, c, c) what is added to the last c rows and columns of these blocks.
        is_free: (F,) False for frames that are held: they are left out of the system. None if none is.

    Raises:
        LinAlgError: B is not positive definite.
    """

    def __init__(
        self, blocks: Array, diagonal: Array, corners: Array, is_free: NDArray[np.bool_] | None = None
    ) -> None: ...
    def solve_lower(self, right: Array) -> Array:
        """Return L^-1 times R right-hand sides, (F, n, R); 0 in frames that are held."""

    def solve_lower_transposed(self, right: Array) -> Array:
        """Return L^-T times one right-hand side, (F, n); 0 in frames that are held."""

    def log_determinant(self) -> float:
        """Return log det B of the frames that are not held."""
