"""The normal equations of the periodic model, and their solution with the cameras eliminated.

Unknowns of a window of N frames, K base poses, P terms (module `fourier`):

    x    coefficients c_pl (P, K + 1) of the K weights and of the heading, which is function K + 1; then the
         frequency omega. G = P (K + 1) + 1.
    z_t  4 unknowns of each frame's camera: rotation vector w_t of C_t <- exp([w_t]x) C_t, and log scale log s_t.
         Translations are eliminated already (module `joint.objective`).

Chain rule. With u_t = (theta_t, psi_t) the values of the functions at frame t,

    d u_tl / d c_pl = terms_tp,    d u_tl / d omega = slope_tl,    together J_t = d u_t / d x, (K + 1, G)

The joint solver gives the Gauss-Newton matrix H_t and half the gradient h_t of a frame, (K + 4) unknowns: its
weights, the rotation vector v_t of the body's rotation R_t <- exp([v_t]x) R_t and the log scale. Here R_t = C_t
Rz(psi_t). A change of psi_t turns the body about its vertical, which is a_t = C_t e_z in the camera frame, and a
change of the camera turns the body with it, so v_t = w_t + a_t psi_t. The heading is therefore inserted as unknown
K + 1:

    T_t  = d (theta_t, v_t, log s_t) / d (u_t, w_t, log s_t), (K + 4, K + 5)
    H'_t = T_t^T H_t T_t,    h'_t = T_t^T h_t

Normal equations. H'_uu, H'_uz and H'_zz are the parts of H' that belong to u_t and z_t, likewise h'_u and h'_z. D
is the diagonal matrix of the prior weights lambda / var_pl (0 for omega). The columns of g_t are the gradients of
the bone lengths by u_t, times the square roots of their weights; the eliminated mean bone lengths subtract
b b^T / N. Q is the matrix of the camera terms (module `periodic.objective`), m_t = vec(M_t), and nu' = nu / N.

    [ A    B ] [dx]     [a]        A       = sum_t J_t^T H'_uu,t J_t - b b^T / N + D,    b = sum_t J_t^T g_t
    [ B^T  C ] [dz] = - [c]        B       = (B_1 ... B_N),    B_t = J_t^T H'_uz,t
                                   C_tu    = (dm_t/dz_t)^T Q_tu (dm_u/dz_u)
                                   C_tt   += H'_zz,t + nu' (dtilt_t/dz_t)^T (dtilt_t/dz_t)
                                   a       = sum_t J_t^T h'_u,t + D x
                                   c_t     = h'_z,t + (dm_t/dz_t)^T sum_u Q_tu m_u + nu' (dtilt_t/dz_t)^T tilt_t

Elimination. Acceleration couples a frame with the next two, so C is a band matrix of 3 * 4 = 12 stored diagonals.
With its Cholesky factorisation C = L L^T, V = L^-1 B^T and v = L^-1 c, the Schur complement leaves a dense system
for the series, and the cameras follow by back substitution:

    S  = A - B C^-1 B^T = A - V^T V
    dx = - S^-1 (a - V^T v)
    dz = - L^-T (v + V dx)

Band storage (LAPACK, lower): band[d, i] = C[i + d, i], row 0 the main diagonal and row d the d-th below it; column
i = 4 t + j is unknown j of frame t. Thus rows 0 to 3 - j of column 4 t + j hold the lower triangle of block C_tt,
the next 4 rows belong to block C_(t+1)t and the next 4 to C_(t+2)t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, lapack

from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, fill_camera_jacobian, fill_rotation_jacobian
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.fourier import FourierSeries
from mocap_ros.solvers.periodic.objective import PeriodicObjective

Array = NDArray[np.float64]

# Added to diagonals that are factorised; both are far below the information of a single seen joint.
MIN_CAMERA_INFORMATION = 1e-6  # m^2; the prior of the cameras is singular, for it leaves a constant camera free
MIN_INFORMATION = 1e-12  # m^2; keeps the equations solvable where the image does not determine an unknown


@dataclass(frozen=True, eq=False)
class ReducedNormalEquations:
    """Normal equations of the series and the cameras, in the symbols at the head of this module.

    Attributes:
        series_matrix: (G, G) the matrix A. The order of the G unknowns is that of the flattened coefficients (P,
            K + 1), then omega.
        series_gradient: (G,) the vector a.
        series_prior: (G,) the diagonal of D, 0 for omega.
        coupling: (G, 4 N) the matrix B.
        camera_band: (12, 4 N) the matrix C in lower band storage.
        camera_gradient: (4 N,) the vector c.
        camera_prior_band: (12, 4 N) the part of C that does not come from the image, that is, C without H'_zz.
        camera_image_blocks: (N, 4, 4) the part of the blocks C_tt that comes from the image, H'_zz.
        camera_blocks: (N, 4, 4) the blocks C_tt.
    """

    series_matrix: Array
    series_gradient: Array
    series_prior: Array
    coupling: Array
    camera_band: Array
    camera_gradient: Array
    camera_prior_band: Array
    camera_image_blocks: Array
    camera_blocks: Array

    @staticmethod
    def build(objective: PeriodicObjective, series: FourierSeries, cameras: State) -> ReducedNormalEquations:
        """Return the normal equations at a series and cameras, whose theta is ignored."""
        equations = objective.problem.normal_equations(
            objective.problem.fit(objective.body_state(series, cameras))
        )
        frames, k = len(cameras.rotation), series.coefficients.shape[1]
        hessian, gradient = _insert_heading(equations.diagonal, equations.gradient, cameras.rotation[:, :, 2])

        bones = np.zeros((frames, k, equations.bones.shape[-1]))
        bones[:, :-1] = equations.bones[:, : k - 1]
        jacobian = series.jacobian(objective.times)
        series_bones = jacobian.sum_transposed_products(bones)
        series_matrix = jacobian.sum_congruences(hessian[:, :k, :k]) - series_bones @ series_bones.T / frames
        series_gradient = jacobian.sum_transposed_products(gradient[:, :k, None])[:, 0]
        coupling = jacobian.transposed_products(hessian[:, :k, k:]).reshape(-1, frames * CAMERA_UNKNOWNS)
        series_prior = np.zeros(len(series_matrix))
        series_prior[: objective.prior.size] = objective.prior.ravel()
        np.einsum('ii->i', series_matrix)[:] += series_prior
        series_gradient[: objective.prior.size] += (objective.prior * series.coefficients).ravel()

        prior_blocks, prior_band, prior_gradient = _camera_prior_equations(objective, cameras)
        image_blocks = hessian[:, k:, k:]
        camera_band = prior_band.copy(order='F')
        for row, column in zip(*np.tril_indices(CAMERA_UNKNOWNS), strict=True):
            camera_band[row - column, column::CAMERA_UNKNOWNS] += image_blocks[:, row, column]
        return ReducedNormalEquations(
            series_matrix,
            series_gradient,
            series_prior,
            coupling,
            camera_band,
            (gradient[:, k:] + prior_gradient).ravel(),
            prior_band,
            image_blocks,
            image_blocks + prior_blocks,
        )

    def effective_parameters(self) -> float:
        """Return the effective number of parameters, that is, of coordinates that the unknowns fit.

            tr(A^-1 (A - D)) + sum_t tr(C_tt^-1 H'_zz,t) + 2 N

        Series and cameras are counted with the other fixed; the last term counts the translations.
        """
        n = len(self.series_matrix)
        regularised = self.series_matrix + MIN_INFORMATION * np.eye(n)
        series = n - np.trace(np.linalg.solve(regularised, np.diag(self.series_prior)))
        camera_blocks = self.camera_blocks + MIN_INFORMATION * np.eye(CAMERA_UNKNOWNS)
        cameras = np.einsum('nii->', np.linalg.solve(camera_blocks, self.camera_image_blocks))
        return float(series + cameras + 2 * len(self.camera_image_blocks))

    def camera_log_determinant_ratio(self) -> float:
        """Return log det C - log det C_prior, minus twice the log of the cameras' posterior over prior volume."""
        return _log_determinant(self.camera_band) - _log_determinant(self.camera_prior_band)

    def solve_step(self, damping: float) -> tuple[Array, Array] | None:
        """Solve for a Levenberg-Marquardt step by the elimination at the head of this module.

        Args:
            damping: relative increase of the diagonals of A and C.

        Returns:
            The step (G,) of the series and the step (N, 4) of the cameras; None if C or S is not positive
            definite.
        """
        band = self.camera_band.copy(order='F')
        band[0] = band[0] * (1 + damping) + MIN_INFORMATION
        factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)  # C = L L^T, banded Cholesky
        if info:
            return None
        right = np.concatenate([self.coupling, self.camera_gradient[None]])
        solved, _ = lapack.dtbtrs(factor, right.T, uplo='L', overwrite_b=1)  # L^-1 (B^T, c), banded triangular
        v_matrix, v_vector = solved[:, :-1], solved[:, -1]
        schur = self.series_matrix - v_matrix.T @ v_matrix
        on_diagonal = np.einsum('ii->i', schur)
        on_diagonal += damping * np.diag(self.series_matrix) + MIN_INFORMATION
        try:
            schur_factor = cho_factor(schur, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return None
        step = -cho_solve(schur_factor, self.series_gradient - v_matrix.T @ v_vector, check_finite=False)
        camera_right = -(v_vector + v_matrix @ step)
        camera_step, _ = lapack.dtbtrs(factor, camera_right[:, None], uplo='L', trans='T')  # L^-T
        return step, camera_step.reshape(-1, CAMERA_UNKNOWNS)


def _log_determinant(band: Array) -> float:
    """Return the log determinant of a matrix in lower band storage; infinity if it is not positive definite."""
    band = band.copy(order='F')
    band[0] += MIN_CAMERA_INFORMATION
    factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
    return np.inf if info else float(2 * np.log(factor[0]).sum())


def _insert_heading(hessian: Array, gradient: Array, vertical: Array) -> tuple[Array, Array]:
    """Return T_t^T H_t T_t (N, K + 5, K + 5) and T_t^T h_t (N, K + 5): the heading becomes unknown K + 1.

    Args:
        hessian: (N, K + 4, K + 4) the matrices H_t.
        gradient: (N, K + 4) the vectors h_t.
        vertical: (N, 3) the body's vertical in the camera frame, a_t.
    """
    frames, n = gradient.shape
    k = n - CAMERA_UNKNOWNS
    transform = np.zeros((frames, n, n + 1))
    transform[:, range(k), range(k)] = 1.0
    transform[:, range(k, n), range(k + 1, n + 1)] = 1.0
    transform[:, k : k + 3, k] = vertical
    transposed = np.swapaxes(transform, -1, -2)
    return transposed @ hessian @ transform, (transposed @ gradient[..., None])[..., 0]


def _camera_prior_equations(objective: PeriodicObjective, cameras: State) -> tuple[Array, Array, Array]:
    """Return what velocity, acceleration and tilt add to C and c.

    Returns:
        The blocks (N, 4, 4) of C_tt, the whole matrix (12, 4 N) in lower band storage, and the gradient (N, 4).
    """
    frames = len(cameras.rotation)
    scaled = np.exp(cameras.log_scale)[:, None, None] * cameras.rotation
    jacobian = _camera_matrix_jacobian(np.swapaxes(scaled, -1, -2))
    gradient = (jacobian * objective.camera_half_gradient(scaled[:, :2])[..., None]).sum(axis=(1, 2))
    tilt = _tilt_jacobian(cameras.rotation[:, :, 2])
    gradient += objective.level_weight * (tilt * cameras.rotation[:, ::2, 2, None]).sum(axis=1)
    rows = jacobian.reshape(frames, 6, CAMERA_UNKNOWNS)
    movement = objective.camera_bands[0, :, None, None] * (np.swapaxes(rows, -1, -2) @ rows)
    blocks = movement + objective.level_weight * (np.swapaxes(tilt, -1, -2) @ tilt)
    return blocks, _pack_camera_band(blocks, rows, objective.camera_bands), gradient


def _camera_matrix_jacobian(columns: Array) -> Array:
    """Return dm_t/dz_t (N, 2, 3, 4): derivatives of M_t by rotation vector and log scale.

    Args:
        columns: (N, 3, 3) columns of s_t C_t, one in each row.
    """
    out = np.empty((len(columns), 2, 3, CAMERA_UNKNOWNS))
    fill_camera_jacobian(np.swapaxes(out, 1, 2), columns)
    return out


def _tilt_jacobian(vertical: Array) -> Array:
    """Return dtilt_t/dz_t (N, 2, 4): derivatives of the x and z components of C_t e_z (N, 3)."""
    out = np.zeros((len(vertical), 3, CAMERA_UNKNOWNS))
    fill_rotation_jacobian(out[..., :3], vertical)
    return out[:, ::2]


def _pack_camera_band(diagonal_blocks: Array, jacobian: Array, camera_bands: Array) -> Array:
    """Return (12, 4 N) the prior part of C in lower band storage.

    Args:
        diagonal_blocks: (N, 4, 4) blocks of the main diagonal.
        jacobian: (N, 6, 4) dm_t/dz_t, from which the two blocks below a diagonal block are computed.
        camera_bands: (3, N) bands of Q.
    """
    frames, n, _ = diagonal_blocks.shape
    transposed = np.swapaxes(jacobian, -1, -2)
    # Each column of C from the first row of its own diagonal block down, with n spare elements for the shift
    # below.
    columns = np.zeros((frames, n, 4 * n))
    columns[:, :, :n] = diagonal_blocks
    for below in (1, 2):
        block = transposed[:-below] @ jacobian[below:]
        columns[: max(frames - below, 0), :, n * below : n * (below + 1)] = (
            camera_bands[below, :-below, None, None] * block
        )
    c = np.arange(n)[:, None]
    # The band begins each column at its diagonal element: column j of a block is shifted by j.
    return np.ascontiguousarray(columns[:, c, c + np.arange(3 * n)].reshape(frames * n, 3 * n)).T
