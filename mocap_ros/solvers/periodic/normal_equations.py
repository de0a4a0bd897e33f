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
from numpy.typing import NDArray

from mocap_ros.engine import block_banded
from mocap_ros.engine import joint as engine
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS
from mocap_ros.solvers.periodic.fourier import SeriesJacobian

Array = NDArray[np.float64]

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
    def begin(body: engine.JointProblem, vertical: Array, jacobian: SeriesJacobian) -> PeriodicEquations:
        """Return the equations of the body alone, with its vertical (N, 3) in the camera frame, a_t."""
        matrix, gradient, bone_vectors = insert_heading(body, vertical)
        frames, functions = len(vertical), len(jacobian.slopes[0])
        bones = jacobian.sum_products(np.swapaxes(bone_vectors, 1, 2)) / np.sqrt(frames)
        series_matrix = jacobian.sum_congruences(matrix[:, :functions, :functions]) - bones.T @ bones
        return PeriodicEquations(
            series_matrix=series_matrix,
            series_prior=np.zeros(len(series_matrix)),
            series_gradient=jacobian.sum_products(gradient[:, None, :functions])[0],
            mixed_matrix=jacobian.products(matrix[:, functions:, :functions]),
            camera_image=matrix[:, functions:, functions:],
            camera_prior=np.zeros((frames, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS)),
            camera_coupling=np.zeros((frames, COUPLED_FRAMES, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS)),
            camera_gradient=gradient[:, functions:].copy(),
        )

    def count_effective_parameters(self) -> float:
        """Return the effective number of parameters, that is, of coordinates that the unknowns fit.

            tr(A^-1 (A - D)) + sum_t tr(C_tt^-1 H'_zz,t) + 2 N

        Series and cameras are counted with the other fixed; the last term counts the translations.
        """
        n, frames = len(self.series_matrix), len(self.camera_image)
        series = n - self._trace_of_prior_share()
        camera_blocks = self.camera_image + self.camera_prior + MIN_INFORMATION * np.eye(CAMERA_UNKNOWNS)
        cameras = np.einsum('nii->', np.linalg.solve(camera_blocks, self.camera_image))
        return float(series + cameras + 2 * frames)

    def _trace_of_prior_share(self) -> float:
        """Return tr(A^-1 D)."""
        matrix = self.series_matrix + np.diag(self.series_prior + MIN_INFORMATION)
        return float(np.linalg.inv(matrix).diagonal() @ self.series_prior)

    def camera_log_determinant_ratio(self) -> float:
        """Return log det C - log det E, minus twice the log of the cameras' posterior over prior volume."""
        return self._log_determinant(self.camera_image + self.camera_prior) - self._log_determinant(
            self.camera_prior
        )

    def _log_determinant(self, diagonal: Array) -> float:
        """Return the log determinant of a camera matrix with these diagonal blocks; infinity if not definite."""
        definite = diagonal + MIN_CAMERA_INFORMATION * np.eye(CAMERA_UNKNOWNS)
        try:
            return self._factorise_cameras(definite).log_determinant()
        except LinAlgError:
            return np.inf

    def _factorise_cameras(self, blocks: Array) -> block_banded.BlockCholesky:
        none = np.zeros((len(blocks), COUPLED_FRAMES, CAMERA_UNKNOWNS))
        return block_banded.BlockCholesky(blocks, none, self.camera_coupling)

    def solve_step(self, damping: float) -> Step | None:
        """Return the step with diagonals of A and C raised by `damping`; None if not positive definite."""
        camera_blocks = self.camera_image + self.camera_prior
        on_diagonal = np.einsum('nii->ni', camera_blocks)
        on_diagonal *= 1 + damping
        on_diagonal += MIN_INFORMATION
        try:
            factor = self._factorise_cameras(camera_blocks)
        except LinAlgError:
            return None
        frames, n, size = self.mixed_matrix.shape
        right = np.empty((frames, n, size + 1))
        right[:, :, :-1], right[:, :, -1] = self.mixed_matrix, self.camera_gradient
        solved = factor.solve_lower(right).reshape(frames * n, size + 1)  # L^-1 (B^T, c)
        v_matrix, v_vector = solved[:, :-1], solved[:, -1]
        schur = self.series_matrix - v_matrix.T @ v_matrix
        diagonal = self.series_prior + np.einsum('ii->i', self.series_matrix)
        np.einsum('ii->i', schur)[:] += self.series_prior + damping * diagonal + MIN_INFORMATION
        try:
            np.linalg.cholesky(schur)  # S is positive definite
            step = np.linalg.solve(schur, v_matrix.T @ v_vector - self.series_gradient)
        except LinAlgError:
            return None
        camera_right = -(v_vector + v_matrix @ step).reshape(frames, n)
        return Step(step, factor.solve_lower_transposed(camera_right))


def insert_heading(body: engine.JointProblem, vertical: Array) -> tuple[Array, Array, Array]:
    """Return H' (N, K + 5, K + 5), h' (N, K + 5) and g (N, K + 1, B), with the heading as unknown K + 1."""
    frames, n = body.gradient.shape
    k = n - CAMERA_UNKNOWNS
    turn, kept = slice(k, k + 3), ((slice(0, k), slice(0, k)), (slice(k, n), slice(k + 1, n + 1)))
    blocks = np.where(np.tri(n, dtype=bool), body.diagonal, np.swapaxes(body.diagonal, 1, 2))
    column = (blocks[:, :, turn] @ vertical[:, :, None])[..., 0]
    matrix, gradient = np.empty((frames, n + 1, n + 1)), np.empty((frames, n + 1))
    for old, new in kept:
        gradient[:, new] = body.gradient[:, old]
        matrix[:, k, new] = matrix[:, new, k] = column[:, old]
        for old_column, new_column in kept:
            matrix[:, new, new_column] = blocks[:, old, old_column]
    matrix[:, k, k] = (vertical * column[:, turn]).sum(axis=1)
    gradient[:, k] = (vertical * body.gradient[:, turn]).sum(axis=1)
    bones = np.zeros((frames, k + 1, body.bone_vectors.shape[2]))
    bones[:, :k] = body.bone_vectors[:, :k]
    return matrix, gradient, bones
