# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rotation vectors and inverses of small matrices, for the kernels of the extremities."""

from __future__ import annotations

import math

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, INPUT_2D, kernel

Array = NDArray[np.float64]

MIN_ANGLE = 1e-9  # rad; below it a rotation vector is its sine
MIN_PIVOT = 1e-12  # guards the square roots of a Cholesky factorisation against rounding


@kernel(void(FLOATS_1D, INPUT_2D))
def write_vector(out: Array, rotation: Array) -> None:
    """Write the rotation vector (3,) rad of a rotation (3, 3) by less than pi."""
    out[0] = (rotation[2, 1] - rotation[1, 2]) / 2
    out[1] = (rotation[0, 2] - rotation[2, 0]) / 2
    out[2] = (rotation[1, 0] - rotation[0, 1]) / 2
    sine = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if sine > MIN_ANGLE:
        out *= math.atan2(sine, (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1) / 2) / sine


@kernel(void(FLOATS_2D, FLOATS_2D))
def write_inverse(out: Array, matrix: Array) -> None:
    """Write the inverse of a positive definite matrix (n, n), which is overwritten, by Cholesky's method."""
    n = len(matrix)
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(rest, MIN_PIVOT)) if i == j else rest / matrix[j, j]
    for c in range(n):
        for i in range(n):
            rest = 1.0 if i == c else 0.0
            for k in range(i):
                rest -= matrix[i, k] * out[k, c]
            out[i, c] = rest / matrix[i, i]
        for i in range(n - 1, -1, -1):
            rest = out[i, c]
            for k in range(i + 1, n):
                rest -= matrix[k, i] * out[k, c]
            out[i, c] = rest / matrix[i, i]
