# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The normal equations of the periodic model, and their solution with the cameras eliminated.

    x    G = P (K + 1) + 1 coefficients c_pl of the K weights and the heading, then the frequency omega
    z_t  4 unknowns of each frame's camera: rotation vector w_t of C_t <- exp([w_t]x) C_t, and log scale log s_t

With u_t = (theta_t, psi_t) the values of the functions,

    d u_tl / d c_pl = terms_tp,    d u_tl / d omega = slope_tl,    together J_t = d u_t / d x, (K + 1, G)

The joint solver gives the matrix H_t and half the gradient h_t of a frame, by its weights, the rotation vector v_t
of the body's rotation C_t Rz(psi_t), and the log scale. psi_t turns the body about a_t = C_t e_z, so v_t = w_t +
a_t psi_t, and the heading is inserted as unknown K + 1 of H'_t with the column H_tv a_t, the diagonal a_t^T H_vv
a_t, and a_t^T h_v in h'_t. The columns of g_t are the gradients of the bone lengths by u_t, whose eliminated means
subtract b b^T / N. D (diagonal, 0 for omega), E (cameras of frames up to two apart), d and e belong to
`periodic.objective`:

    [ A    B ] [dx]     [a]        A    = sum_t J_t^T H'_uu,t J_t - b b^T / N + D,    b = sum_t J_t^T g_t
    [ B^T  C ] [dz] = - [c]        B^T  = (B_1^T; ... B_N^T),    B_t^T = H'_zu,t J_t
                                   C_tu = E_tu,    C_tt = E_tt + H'_zz,t
                                   a    = sum_t J_t^T h'_u,t + d,    c_t  = h'_z,t + e_t

With the block Cholesky factorisation C = L L^T (`block_banded`), V = L^-1 B^T and v = L^-1 c,

    dx = - (A - V^T V)^-1 (a - V^T v),    dz = - L^-T (v + V dx)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mocap_ros.arrays import Array
from mocap_ros.engine import block_banded, joint
from mocap_ros.engine import periodic as engine
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS

COUPLED_FRAMES = 2  # next frames with which each camera is coupled: acceleration compares three
# Added to diagonals that are factorised; both are far below the information of a single seen joint.
MIN_CAMERA_INFORMATION = 1e-6  # m^2; the prior of the cameras is singular, for it leaves a constant camera free
MIN_INFORMATION = 1e-12  # m^2; keeps the equations solvable where the image does not determine an unknown


class Step(NamedTuple):
    """A step of Levenberg-Marquardt."""

    series: Array  # (G,) change of the flattened coefficients and, in the last element, of omega
    cameras: Array  # (N, 4) rotation vectors and changes of the log scale


@dataclass(frozen=True, eq=False)
class PeriodicEquations:
    """The equations of a window in the symbols at the head of this module; terms add to the arrays in place.

    The order of the G unknowns of the series is that of the flattened coefficients (P, K + 1), then omega.
    """

    series_matrix: Array  # (G, G) the matrix A without D
    series_prior: Array  # (G,) the diagonal of D
    series_gradient: Array  # (G,) the vector a
    mixed_matrix: Array  # (N, 4, G) the matrix B^T
    camera_image: Array  # (N, 4, 4) the matrices H'_zz
    camera_prior: Array  # (N, 4, 4) the diagonal blocks of E
    # (N, 2, 4, 4) the blocks of E in the rows of frame t + d + 1 and the columns of frame t
    camera_coupling: Array
    camera_gradient: Array  # (N, 4) the vector c

    @staticmethod
    def begin(body: joint.JointProblem, vertical: Array, terms: Array, slopes: Array) -> PeriodicEquations:
        """Return the equations of the body alone, with its vertical (N, 3) in the camera frame, a_t."""
        derivatives = body.diagonal, body.gradient, body.bone_vectors
        matrix, gradient, mixed, image, camera_gradient = engine.assemble(*derivatives, vertical, terms, slopes)
        return PeriodicEquations(
            series_matrix=matrix,
            series_prior=np.zeros(len(matrix)),
            series_gradient=gradient,
            mixed_matrix=mixed,
            camera_image=image,
            camera_prior=np.zeros_like(image),
            camera_coupling=np.zeros((len(image), COUPLED_FRAMES, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS)),
            camera_gradient=camera_gradient,
        )

    def count_effective_parameters(self) -> float:
        """Return the effective number of parameters, that is, of coordinates that the unknowns fit.

            tr(A^-1 (A - D)) + sum_t tr(C_tt^-1 H'_zz,t) + 2 N

        Series and cameras are counted with the other fixed; the last term counts the translations.
        """
        n, frames = len(self.series_matrix), len(self.camera_image)
        added = self.series_prior + MIN_INFORMATION
        series = n - engine.compute_trace_of_solved(self.series_matrix, added, self.series_prior)
        camera_blocks = self.camera_image + self.camera_prior + MIN_INFORMATION * np.eye(CAMERA_UNKNOWNS)
        cameras = np.einsum('nii->', np.linalg.solve(camera_blocks, self.camera_image))
        return float(series + cameras + 2 * frames)

    def camera_log_determinant_ratio(self) -> float:
        """Return log det C - log det E, minus twice the log of the cameras' posterior over prior volume."""
        return self._log_determinant(self.camera_image + self.camera_prior) - self._log_determinant(
            self.camera_prior
        )

    def _log_determinant(self, diagonal: Array) -> float:
        """Return the log determinant of a camera matrix with these diagonal blocks; infinity if not definite."""
        definite = diagonal + MIN_CAMERA_INFORMATION * np.eye(CAMERA_UNKNOWNS)
        none = np.zeros((len(diagonal), COUPLED_FRAMES, CAMERA_UNKNOWNS))
        try:
            return block_banded.log_determinant(definite, none, self.camera_coupling)
        except LinAlgError:
            return np.inf

    def solve_step(self, damping: float) -> Step | None:
        """Return the step with diagonals of A and C raised by `damping`; None if not positive definite."""
        camera_blocks = self.camera_image + self.camera_prior
        on_diagonal = np.einsum('nii->ni', camera_blocks)
        on_diagonal *= 1 + damping
        on_diagonal += MIN_INFORMATION
        added = (1 + damping) * self.series_prior + damping * self.series_matrix.diagonal() + MIN_INFORMATION
        cameras = self.mixed_matrix, camera_blocks, self.camera_coupling, self.camera_gradient
        step = engine.solve_step(self.series_matrix, added, self.series_gradient, *cameras)
        return None if step is None else Step(*step)
