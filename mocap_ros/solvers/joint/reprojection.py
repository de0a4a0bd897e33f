# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The reprojection term, robust and in perspective where the focal length is known (TPAMI 2016, eq. 9).

    sum_tj w_tj rho(|e_tj|^2) / v_t,    e_tj = (s_t R_t[:2] P_tj + t_t) / d_tj - x_tj / s0,
    d_tj = 1 + s_t R_t[2] P_tj / f,     rho(a) = c^2 log(1 + a / c^2)  (Cauchy's loss; c infinite: least squares)

with x_tj the image point in px, s0 the sequence's unit in px/m, f the focal length in that unit (infinite under
weak perspective, where d = 1), w_tj the detector's score, and v_t the variance of the image noise over that of the
reference (10 mm). So image errors are metres at the body.

The errors are those of the scaled joint positions q_tj = s_t R_t P_tj in the camera's frame, so the term adds to
the normal equations through the joints (`normal_equations`). With a_tj = e_tj + x_tj / s0 the projected joint and
E_tj its derivatives by the joint,

    E_tj = (1 0 -a_x/f; 0 1 -a_y/f) / d_tj,    M_tj = u E^T E,    m_tj = u E^T e,    u = w_tj rho'(|e_tj|^2) / v_t

The translation t_t is never an unknown of the step; it is eliminated with U_tj = u E^T / d, w = sum_j u / d^2 and
v = sum_j u e / d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import BOOL, FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, kernel
from mocap_ros.config import SolverConfig
from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

MIN_DEPTH = 0.1  # of the depth of the body's origin; a joint nearer to the camera than that is a failed solution
MIN_ROBUST_SCALE = 1e-6  # m; a smaller `robust_scale` selects least squares
MIN_TOTAL_WEIGHT = 1e-12  # guards the division by the weights of a frame in which no joint is seen


@dataclass(frozen=True, eq=False)
class Reprojection:
    """The term of a batch.

    Attributes:
        image: (N, J, 2) m, image points in the sequence's unit.
        weight: (N, J) detector scores over `variance_ratio`.
        variance_ratio: (N,) variance of the image noise over that of the reference.
        robust_scale: (N,) m, scale c of Cauchy's loss; infinite for least squares.
        focal: (N,) focal length in the sequence's unit (m); infinite for weak perspective.
    """

    image: Array
    weight: Array
    variance_ratio: Array
    robust_scale: Array
    focal: Array

    @staticmethod
    def build(windows: Sequence[Window], units: Array, config: SolverConfig) -> Reprojection:
        """Return the term of these windows, each divided by its unit (P,) px/m; the noise is the reference's."""
        counts = [len(w.times) for w in windows]
        robust = config.robust_scale if config.robust_scale > MIN_ROBUST_SCALE else np.inf
        points, frame_units = np.concatenate([w.points for w in windows]), np.repeat(units, counts)
        return Reprojection(
            image=points / frame_units[:, None, None],
            weight=np.concatenate([w.weight for w in windows]),
            variance_ratio=np.ones(len(points)),
            robust_scale=np.full(len(points), robust),
            focal=np.repeat([w.focal for w in windows], counts) / frame_units,
        )

    def subsampled(self, kept: Subsample) -> Reprojection:
        """Return the term of some frames only."""
        frames = kept.frames
        return Reprojection(
            self.image[frames],
            self.weight[frames],
            self.variance_ratio[frames],
            self.robust_scale[frames],
            self.focal[frames],
        )

    def with_variance_ratio(self, ratio: Array) -> Reprojection:
        """Return the term under another image noise.

        The scale of the robust loss grows with noise above the reference, and never shrinks.

        Args:
            ratio: (N,) standard deviation of the noise over that of the reference.
        """
        old = np.sqrt(self.variance_ratio)
        return Reprojection(
            image=self.image,
            weight=self.weight * (self.variance_ratio / ratio**2)[:, None],
            variance_ratio=ratio**2,
            robust_scale=self.robust_scale * (np.maximum(ratio, 1) / np.maximum(old, 1)),
            focal=self.focal,
        )

    def measure(
        self, scaled_poses: Array, translation: Array, *, settle_translation: bool
    ) -> tuple[Array, Array, Array, Array]:
        """Project scaled poses.

        Args:
            scaled_poses: (N, J, 3) m.
            translation: (N, 2) m.
            settle_translation: whether to move each translation to its optimum, by one step of the robust fit.

        Returns:
            The translation (N, 2), relative depths (N, J), errors (N, J, 2) m and their squared lengths (N, J).
        """
        return _project(
            scaled_poses,
            translation,
            self.image,
            self.weight,
            self.robust_scale,
            self.focal,
            settle_translation,
        )

    def centroids(self) -> Array:
        """(N, 2) m, weighted centroids of the image points."""
        total = np.maximum(self.weight.sum(axis=1), MIN_TOTAL_WEIGHT)[:, None]
        return np.asarray((self.weight[..., None] * self.image).sum(axis=1) / total)

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of the term in each frame."""
        return _sum_loss(self.weight, self.robust_scale, fit.squared_error)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrices and gradients by the joints and by the translation, in place."""
        _add_errors(
            self.image,
            self.weight,
            self.robust_scale,
            self.focal,
            fit.depth,
            fit.error,
            fit.squared_error,
            equations.image_matrix,
            equations.joint_gradient,
            equations.translation_coupling,
            equations.translation_matrix,
            equations.translation_gradient,
        )

    def with_components(self, k: int) -> Reprojection:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the number of base poses."""
        return self


@kernel(
    types.Tuple((FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_2D))(
        FLOATS_3D, FLOATS_2D, FLOATS_3D, FLOATS_2D, FLOATS_1D, FLOATS_1D, BOOL
    )
)
def _project(
    scaled_poses: Array,
    start: Array,
    image: Array,
    weight: Array,
    robust_scale: Array,
    focal: Array,
    settle_translation: bool,
) -> tuple[Array, Array, Array, Array]:
    """Return translations, depths, errors and squared errors; see `Reprojection.measure`."""
    frames, joints = weight.shape
    translation = start.copy()
    depth, squared = np.empty((frames, joints)), np.empty((frames, joints))
    error = np.empty((frames, joints, 2))
    for t in range(frames):
        total, shift_x, shift_y = 0.0, 0.0, 0.0
        for j in range(joints):
            d = max(1 + scaled_poses[t, j, 2] / focal[t], MIN_DEPTH)
            x = (scaled_poses[t, j, 0] + translation[t, 0]) / d - image[t, j, 0]
            y = (scaled_poses[t, j, 1] + translation[t, 1]) / d - image[t, j, 1]
            depth[t, j], error[t, j, 0], error[t, j, 1], squared[t, j] = d, x, y, x * x + y * y
            u = weight[t, j] / (1 + squared[t, j] / robust_scale[t] ** 2) / d
            total += u / d
            shift_x -= u * x
            shift_y -= u * y
        if not settle_translation:
            continue
        total = max(total, MIN_TOTAL_WEIGHT)
        shift_x, shift_y = shift_x / total, shift_y / total
        translation[t, 0] += shift_x
        translation[t, 1] += shift_y
        for j in range(joints):
            x, y = error[t, j, 0] + shift_x / depth[t, j], error[t, j, 1] + shift_y / depth[t, j]
            error[t, j, 0], error[t, j, 1], squared[t, j] = x, y, x * x + y * y
    return translation, depth, error, squared


@kernel(FLOATS_1D(FLOATS_2D, FLOATS_1D, FLOATS_2D))
def _sum_loss(weight: Array, robust_scale: Array, squared: Array) -> Array:
    """Return sum_j w_tj rho(|e_tj|^2) of each frame, (N,)."""
    frames, joints = weight.shape
    out = np.zeros(frames)
    for t in range(frames):
        c = robust_scale[t] ** 2
        for j in range(joints):
            out[t] += weight[t, j] * (squared[t, j] if np.isinf(c) else c * np.log1p(squared[t, j] / c))
    return out


@kernel(
    void(
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_1D,
        FLOATS_1D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_4D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_1D,
        FLOATS_2D,
    )
)
def _add_errors(
    image: Array,
    weight: Array,
    robust_scale: Array,
    focal: Array,
    depth: Array,
    error: Array,
    squared: Array,
    image_matrix: Array,
    joint_gradient: Array,
    translation_coupling: Array,
    translation_matrix: Array,
    translation_gradient: Array,
) -> None:
    """Add the term to what the normal equations hold by joints and translations (formulas at the head)."""
    frames, joints = weight.shape
    for t in range(frames):
        for j in range(joints):
            d, x, y = depth[t, j], error[t, j, 0], error[t, j, 1]
            u = weight[t, j] / (1 + squared[t, j] / robust_scale[t] ** 2)
            a, b = -(x + image[t, j, 0]) / focal[t], -(y + image[t, j, 1]) / focal[t]
            v = u / (d * d)
            m = image_matrix[t, j]
            m[0, 0] += v
            m[1, 1] += v
            m[0, 2] += v * a
            m[2, 0] += v * a
            m[1, 2] += v * b
            m[2, 1] += v * b
            m[2, 2] += v * (a * a + b * b)
            pull = u / d
            joint_gradient[t, 3 * j] += pull * x
            joint_gradient[t, 3 * j + 1] += pull * y
            joint_gradient[t, 3 * j + 2] += pull * (a * x + b * y)
            translation_coupling[t, 3 * j, 0] += v
            translation_coupling[t, 3 * j + 1, 1] += v
            translation_coupling[t, 3 * j + 2, 0] += v * a
            translation_coupling[t, 3 * j + 2, 1] += v * b
            translation_matrix[t] += v
            translation_gradient[t, 0] += pull * x
            translation_gradient[t, 1] += pull * y
