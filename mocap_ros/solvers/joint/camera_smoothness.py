# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The smoothness of the camera over time: the flip regulariser (TPAMI 2016, eq. 12), tilt and scale.

    gamma sum_t |M_t - M_(t-1)|^2 / dt_t           flip regulariser: M_t = s_t R_t[:2], the paper's matrix of the
    camera
  + tau   sum_t |R_t[:2] z - R_(t-1)[:2] z|^2 / dt_t   tilt: the image of the vertical z changes slowly
  + sigma sum_t (log s_t - log s_(t-1))^2 / dt_t   scale: people come nearer slowly

All three are weighted squared changes of nine features of a frame's camera: for each of the two image axes the
three elements of M and the vertical's image, then the logarithm of the scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, kernel
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, write_point_jacobian
from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]

FEATURES = 9  # for both rows of M its three elements and the image of the vertical, then the log of the scale
LOG_SCALE_FEATURE = 8  # the last of them


@dataclass(frozen=True, eq=False)
class CameraSmoothness:
    """The term of a batch.

    Attributes:
        weight: (N - 1, 9) weights of the squared changes of the features, 0 between two sequences.
    """

    weight: Array

    @staticmethod
    def build(inverse_time_steps: Array, flip: float, tilt: float, scale: float) -> CameraSmoothness:
        """Return the term of these weights gamma, tau and sigma; inverse_time_steps (N - 1,) 1/s."""
        return CameraSmoothness(inverse_time_steps[:, None] * ([*[flip] * 3, tilt] * 2 + [scale]))

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each pair of neighbours, counted for the earlier frame."""
        return _measure_change(self.weight, measure_features(fit.state.rotation, fit.state.log_scale))

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling of neighbouring cameras and the gradient, in place."""
        _add_change(
            self.weight,
            measure_features(fit.state.rotation, fit.state.log_scale),
            _differentiate_features(fit.state.rotation, fit.state.log_scale),
            equations.diagonal,
            equations.coupling.corner,
            equations.gradient,
        )

    def subsampled(self, kept: Subsample) -> CameraSmoothness:
        """Return the term of some frames only."""
        return replace(self, weight=self.weight[kept.pairs] * kept.pair_factor[:, None])

    def with_components(self, k: int) -> CameraSmoothness:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the base poses."""
        return self


@kernel(FLOATS_2D(FLOATS_3D, FLOATS_1D))
def measure_features(rotation: Array, log_scale: Array) -> Array:
    """Return the features (N, 9) of cameras of rotations (N, 3, 3) and logarithms of the scale (N,)."""
    out = np.empty((len(log_scale), FEATURES))
    for t in range(len(log_scale)):
        scale = np.exp(log_scale[t])
        for row in range(2):
            for column in range(3):
                out[t, 4 * row + column] = scale * rotation[t, row, column]
            out[t, 4 * row + 3] = rotation[t, row, 2]
        out[t, LOG_SCALE_FEATURE] = log_scale[t]
    return out


@kernel(FLOATS_3D(FLOATS_3D, FLOATS_1D))
def _differentiate_features(rotation: Array, log_scale: Array) -> Array:
    """Return the derivatives (N, 9, 4) of the features by the rotation vector and the logarithm of the scale."""
    out = np.zeros((len(log_scale), FEATURES, CAMERA_UNKNOWNS))
    point, block = np.empty(3), np.empty((3, CAMERA_UNKNOWNS))
    for t in range(len(log_scale)):
        scale = np.exp(log_scale[t])
        for column in range(4):  # the columns of s R, then the vertical, which the scale does not move
            for i in range(3):
                point[i] = scale * rotation[t, i, column] if column < 3 else rotation[t, i, 2]
            write_point_jacobian(point, block, 0, 0)
            for row in range(2):
                for unknown in range(CAMERA_UNKNOWNS):
                    if column < 3 or unknown < 3:
                        out[t, 4 * row + column, unknown] = block[row, unknown]
        out[t, LOG_SCALE_FEATURE, CAMERA_UNKNOWNS - 1] = 1.0
    return out


@kernel(FLOATS_1D(FLOATS_2D, FLOATS_2D))
def _measure_change(weight: Array, features: Array) -> Array:
    """Return the value of each pair of neighbours, (N,), counted for the earlier frame."""
    out = np.zeros(len(features))
    for t in range(len(weight)):
        for c in range(FEATURES):
            change = features[t + 1, c] - features[t, c]
            out[t] += weight[t, c] * change * change
    return out


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_4D, FLOATS_2D))
def _add_change(
    weight: Array, features: Array, jacobian: Array, diagonal: Array, corner: Array, gradient: Array
) -> None:
    """Add the term to the diagonal blocks (N, n, n), the corner of the coupling (1, N, 4, 4) and the gradient."""
    k = gradient.shape[1] - CAMERA_UNKNOWNS
    for t in range(len(weight)):
        for c in range(FEATURES):
            pull = weight[t, c] * (features[t + 1, c] - features[t, c])
            for i in range(CAMERA_UNKNOWNS):
                before, after = jacobian[t, c, i], jacobian[t + 1, c, i]
                gradient[t, k + i] -= before * pull
                gradient[t + 1, k + i] += after * pull
                for j in range(CAMERA_UNKNOWNS):
                    diagonal[t, k + i, k + j] += weight[t, c] * before * jacobian[t, c, j]
                    diagonal[t + 1, k + i, k + j] += weight[t, c] * after * jacobian[t + 1, c, j]
                    corner[0, t, i, j] -= weight[t, c] * after * jacobian[t, c, j]
