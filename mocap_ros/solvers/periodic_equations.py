# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the periodic model (TPAMI 2016, section 3.3), its normal equations, and Levenberg-Marquardt.

    E = sum_tj w_tj rho(|s_t C_t[:2] Rz(psi_t) P_tj + t_t - x_tj|^2 / s0^2)    reprojection error (eq. 18)
      + beta   sum_tb (length_tb - mean_b)^2                                   bone lengths (eq. 20)
      + lambda sum_pl c_pl^2 / var_pl                                          prior of the coefficients
      + gamma  int |dM / dt|^2 dt + kappa int |d^2 M / dt^2|^2 dt              movement of the camera, M = s C[:2]
      + nu     mean_t |tilt_t|^2                                               level cameras

P_tj has the weights theta_t; u_t = (theta_t, psi_t) are Fourier series (`periodic`), psi the turn of the body with
every stride, Rz a rotation about its vertical, C_t the camera without the strides, rho Cauchy's loss. The tilt is
x and z of C_t e_z, for base poses aligned by heading. The paper weighs changes of the camera (eq. 12) and has
neither prior nor tilt. The unknowns of a step are

    x    G = P (K + 1) + 1 coefficients c_pl of the K weights and the heading, then the frequency omega
    z_t  4 unknowns of each frame's camera: rotation vector w_t of C_t <- exp([w_t]x) C_t, and log scale log s_t

and with d u_tl / d c_pl = terms_tp and d u_tl / d omega = slope_tl, together J_t = d u_t / d x, (K + 1, G),

    slope_tl = sum_h h (t - t0) [b_hl cos(h omega (t - t0)) - a_hl sin(h omega (t - t0))]

The joint solver gives the matrix H_t and half the gradient h_t of a frame, by its weights, the rotation vector v_t
of the body's rotation C_t Rz(psi_t), and the log scale. psi_t turns the body about a_t = C_t e_z, so v_t = w_t +
a_t psi_t, and the heading is inserted as unknown K + 1 of H'_t with the column H_tv a_t, the diagonal a_t^T H_vv
a_t, and a_t^T h_v in h'_t. The columns of g_t are the gradients of the bone lengths by u_t, whose eliminated means
subtract b b^T / N. D (diagonal, 0 for omega) and d come from the prior of the coefficients, E (cameras of frames
up to two apart) and e from movement and tilt:

    [ A    B ] [dx]     [a]        A    = sum_t J_t^T H'_uu,t J_t - b b^T / N + D,    b = sum_t J_t^T g_t
    [ B^T  C ] [dz] = - [c]        B^T  = (B_1^T; ... B_N^T),    B_t^T = H'_zu,t J_t
                                   C_tu = E_tu,    C_tt = E_tt + H'_zz,t
                                   a    = sum_t J_t^T h'_u,t + d,    c_t  = h'_z,t + e_t

With the block Cholesky factorisation C = L L^T (`block_banded`), V = L^-1 B^T and v = L^-1 c, S = A - V^T V and s
= a - V^T v, the step is dx = - S^-1 s, dz = - L^-T (v + V dx). One factorisation of a matrix that has a row and a
column more, with any large r, also gives y = U^-T s:

    [ S    s ]   [ U^T    ] [ U  y ]        [ U  y ] [ dx ]   [ 0 ]
    [ s^T  . ] = [ y^T  r ] [    r ],       [    r ] [ 1  ] = [ r ]

The body, a `JointProblem`, has the first two terms, and the cameras, another one without base poses, the last two.

Sizes: N frames, J joints, B bones, K base poses, n = K + 4 unknowns of the joint solver a frame, m = K + 1
functions, P terms of a series, G unknowns of the series.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import block_banded, joint, periodic

MAX_FREQUENCY_STEP = 0.1  # of omega; guards a step against leaving the cadence of its hypothesis
MAX_LOG_SCALE_STEP = 1.0  # of one step; a larger one is a failed linearisation
MIN_FREE_SHARE = 0.05  # of the coordinates; guards the noise estimate against too many unknowns
# m^2; the prior of the cameras leaves a constant camera free; far below the information of a single seen joint
MIN_CAMERA_INFORMATION = 1e-6


class Point(NamedTuple):
    """Values of the unknowns."""

    coefficients: Array  # (P, m) m, in the last column rad
    omega: float  # rad/s
    rotation: Array  # (N, 3, 3) C_t
    log_scale: Array  # (N,)
    translation: Array  # (N, 2) m


class PeriodicProblem:
    """E of one window of N frames, minimised from a point; a `Problem` of `levenberg_marquardt`.

    Args:
        body: reprojection and bone lengths of the window. Problems may share it, of which one after the other is
            minimised; it has the image noise.
        cameras: movement and tilt of the cameras, which problems may share likewise.
        times: (N,) s from the time t0 at which the phases are 0.
        prior: (P, K + 1) lambda / var_pl, the factor on the square of each coefficient.
        start: the point.
        settle_steps: of the robust fit, by which each translation first moves to its optimum.
    """

    def __init__(
        self,
        body: joint.JointProblem,
        cameras: joint.JointProblem,
        times: Array,
        prior: Array,
        start: Point,
        settle_steps: int = 0,
    ) -> None:
        self.body, self.cameras, self.times, self.prior = body, cameras, times, prior
        self.search, self.has_equations = np.zeros(1, joint.SEARCH), False
        (size, m), frames = prior.shape, len(times)
        unknowns = size * m + 1
        self.series_matrix, self.series_gradient = np.empty((unknowns, unknowns)), np.empty(unknowns)
        self.series_prior, self.mixed_matrix = np.append(prior.ravel(), 0.0), np.empty((frames, 4, unknowns))
        self.terms = np.empty((frames, size))
        self.step_solver = periodic.StepSolver(frames, unknowns)
        self.point, cost = self.measure(start, settle_steps)
        self.cost[0] = cost

    @property
    def cost(self) -> Array:
        """E (1,) in m^2 at the point."""
        return np.asarray(self.search['cost'])

    def restart(self) -> None:
        """Set the body to the point, and measure E there."""
        _, self.cost[0] = self.measure(self.point, 0)

    def measure(self, at: Point, settle_steps: int) -> tuple[Point, float]:
        """Return a point with settled translations, at which the body is then, and E there."""
        functions, turned = periodic.evaluate(self.times, at.omega, at.coefficients, at.rotation, self.terms)
        self.body.start(functions[:, :-1], turned, at.log_scale, at.translation, settle_steps)
        self.cameras.start(functions[:, :0], at.rotation, at.log_scale, at.translation)
        of_prior = (self.prior * at.coefficients**2).sum()
        cost = float(self.body.cost[0] + of_prior + self.cameras.cost[0])
        return at._replace(translation=self.body.frames['translation'].copy()), cost

    def estimate_noise(self) -> float:
        """Return the standard deviation (m) of a coordinate of a point of weight 1.

        The squared residuals are shared among the coordinates that the parameters leave free; these may be those
        of the point before the last step:

            noise^2 = sum of squared residuals / (number of coordinates - effective number of parameters)
        """
        parameters, coordinates = (
            self.count_effective_parameters(),
            2 * (self.body.batch.frames['score'] > 0).sum(),
        )
        self.restart()
        loss = self.body.measure_residual()[0]
        return math.sqrt(loss / max(coordinates - parameters, MIN_FREE_SHARE * coordinates + 1))

    def count_effective_parameters(self) -> float:
        """Return the effective number of parameters, that is, of coordinates that the unknowns fit.

            tr(A^-1 (A - D)) + sum_t tr(C_tt^-1 H'_zz,t) + 2 N

        Series and cameras are counted with the other fixed; the last term counts the translations.

        Raises:
            LinAlgError: A or a C_tt is not positive definite.
        """
        self.require_equations()
        blocks = self.camera_image + self.camera_prior
        counted = periodic.count_effective_parameters(
            self.series_matrix, self.series_prior, self.camera_image, blocks
        )
        return counted + 2 * len(blocks)

    def camera_log_determinant_ratio(self) -> float:
        """Return log det C - log det E, minus twice the log of the cameras' posterior over prior volume."""
        self.require_equations()
        small = MIN_CAMERA_INFORMATION * np.eye(4)
        try:
            posterior = block_banded.log_determinant(
                self.camera_image + self.camera_prior + small, self.camera_coupling
            )
            return posterior - block_banded.log_determinant(self.camera_prior + small, self.camera_coupling)
        except np.linalg.LinAlgError:
            return math.inf

    def require_equations(self) -> None:
        """Compute the equations, if there were none yet."""
        if not self.has_equations:
            self.begin(float(self.search['damping'][0]))

    def begin(self, damping: float) -> None:
        """Set the damping of the first step, and compute the equations at the point."""
        self.restart()
        self.search['damping'], self.search['is_done'] = damping, False
        self.update_equations()

    def update_equations(self) -> None:
        """Compute the equations at the point, at which body and cameras are."""
        self.body.begin(0.0)
        self.cameras.begin(0.0)
        coefficients, self.camera_image = self.point.coefficients, self.body.read_camera_blocks()
        slopes = compute_slopes(self.terms, self.times) @ coefficients
        periodic.assemble(
            self.terms,
            slopes,
            self.point.rotation,
            self.body.diagonal,
            self.camera_image,
            self.body.gradient,
            self.body.bone_vectors,
            self.series_matrix,
            self.series_gradient,
            self.mixed_matrix,
        )
        self.series_gradient[:-1] += (self.prior * coefficients).ravel()
        self.camera_prior = self.cameras.read_camera_blocks()
        coupling = self.cameras.coupling.reshape(len(self.times), -1, 4, 4)
        self.camera_coupling = np.swapaxes(coupling, 2, 3).copy()
        self.camera_gradient = self.body.gradient[:, -4:] + self.cameras.gradient
        self.has_equations = True

    def solve(self, damping: float) -> bool:
        """Find the step with diagonals of A and C raised by `damping`; False if one is not positive definite."""
        step = self.step_solver.solve(
            damping,
            self.series_matrix,
            self.series_prior,
            self.mixed_matrix,
            self.camera_image + self.camera_prior,
            self.camera_coupling,
            self.series_gradient,
            self.camera_gradient,
        )
        if step is not None:
            self.series_step, self.camera_step = step
        return step is not None

    def advance(self) -> Point:
        """Return the point after the step."""
        at, x, z = self.point, self.series_step, self.camera_step
        limit = MAX_FREQUENCY_STEP * at.omega
        return Point(
            at.coefficients + x[:-1].reshape(at.coefficients.shape),
            at.omega + min(max(float(x[-1]), -limit), limit),
            periodic.turn_rotations(z[:, :3], at.rotation),
            at.log_scale + np.minimum(np.maximum(z[:, 3], -MAX_LOG_SCALE_STEP), MAX_LOG_SCALE_STEP),
            at.translation,
        )

    def try_steps(self, tolerance: float) -> tuple[int, int]:
        """Try a step; return whether it was taken, and whether it was not the last (`Problem.try_steps`)."""
        trial, cost = self.point, math.inf
        is_definite = self.solve(float(self.search['damping'][0]))
        if is_definite:
            trial, cost = self.measure(self.advance(), 1)
        is_taken = joint.end_step(self.search, is_definite, cost, tolerance)
        if is_taken:
            self.point = trial
        return int(is_taken), int(not self.search['is_done'][0])


def compute_terms(phases: Array, count: int) -> Array:
    """Return the terms (N, P) of a series at phases omega (t - t0) (N,): 1, cos, sin, cos 2, sin 2 and so on."""
    terms, first = np.ones((len(phases), count)), np.exp(1j * phases)
    harmonics = np.cumprod(np.repeat(first[:, None], count // 2, axis=1), axis=1)
    terms[:, 1::2], terms[:, 2::2] = harmonics.real, harmonics.imag
    return terms


def compute_slopes(terms: Array, times: Array) -> Array:
    """Return the derivatives (N, P) of terms by omega."""
    slopes = np.zeros_like(terms)
    scaled = times[:, None] * np.arange(1, terms.shape[1] // 2 + 1)
    slopes[:, 1::2], slopes[:, 2::2] = -scaled * terms[:, 2::2], scaled * terms[:, 1::2]
    return slopes


def fit_series(times: Array, theta: Array, frequencies: Array, ridge: Array) -> tuple[Array, Array]:
    """Fit series to weights at many frequencies: c_l = (T^T T + D)^-1 T^T theta_l, T the terms (N, P) of one.

    `times` (N,) s from the time t0 at which the phases are 0; `theta` (N, K) m; `frequencies` (C,) rad/s; `ridge`
    (P,) the diagonal of D. Returns coefficients (C, P, K) in m and what they explain, (C,) m^2: the sums of
    c_l^T T^T theta_l.
    """
    terms = compute_terms(np.outer(frequencies, times).ravel(), len(ridge)).reshape(
        len(frequencies), len(times), -1
    )
    transposed = np.swapaxes(terms, 1, 2)
    right = transposed @ theta
    fits = np.linalg.solve(transposed @ terms + np.diag(ridge), right)
    return np.asarray(fits), np.asarray((fits * right).sum(axis=(1, 2)))
