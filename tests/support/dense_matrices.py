"""Matrices that the solvers store in bands, as dense arrays."""

from __future__ import annotations

import numpy as np

from mocap_ros.solvers.block_banded import Coupling


def make_dense_coupling(coupling: Coupling) -> np.ndarray:
    """Return the blocks between neighbouring frames as a dense array (F - 1, n, n)."""
    n, c = coupling.diagonal.shape[1], coupling.corner.shape[1]
    out = coupling.diagonal[:, :, None] * np.eye(n)
    out[:, n - c :, n - c :] += coupling.corner
    return out
