# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Matrices that the solvers store in bands, as dense arrays."""

from __future__ import annotations

import numpy as np

from mocap_ros.solvers.block_banded import Coupling


def make_dense_coupling(coupling: Coupling, distance: int = 1) -> np.ndarray:
    """Return the blocks between frames t and t + distance as a dense array (F - distance, n, n)."""
    diagonal, corner = coupling.diagonal[distance - 1], coupling.corner[distance - 1]
    n, c = diagonal.shape[1], corner.shape[1]
    out = diagonal[:, :, None] * np.eye(n)
    out[:, n - c :, n - c :] += corner
    return out[: len(out) - distance]
