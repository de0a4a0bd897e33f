"""The normal equations of the periodic model, with the cameras eliminated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, lapack

from mocap_ros.solvers.joint.objective import CAMERA_UNKNOWNS
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.fourier import Series
from mocap_ros.solvers.periodic.objective import Objective

Array = NDArray[np.float64]

NO_CAMERA, NO_INFORMATION = 1e-6, 1e-12


@dataclass(frozen=True, eq=False)
class Reduced:
    """Normal equations in the series' unknowns and the cameras.

    Attributes:
        matrix: (G, G) of the coefficients, flattened (P, K + 1), and omega, one or K + 1 of them; gradient: (G,).
        prior: (G,) the coefficients' part of its diagonal.
        coupling: (G, N 4) of them to the cameras.
        band: (12, N 4) of the cameras, LAPACK's lower band storage; camera_gradient: (N 4,).
        camera_prior: (12, N 4) the part of `band` that is there without image.
        seen: (N, 4, 4) the image's part of the cameras' diagonal blocks; own: all of them.
    """

    matrix: Array
    gradient: Array
    prior: Array
    coupling: Array
    band: Array
    camera_gradient: Array
    camera_prior: Array
    seen: Array
    own: Array
    shape: tuple[int, int]

    @staticmethod
    def build(objective: Objective, series: Series, cameras: State) -> Reduced:
        """The chain rule from each frame's weights, heading and camera to the series."""
        equations = objective.problem.normal_equations(objective.problem.fit(objective.body(series, cameras)))
        frames, k = len(cameras.rotation), series.coefficients.shape[1]
        hessian, gradient = _with_heading(equations.diagonal, equations.gradient, cameras.rotation[:, :, 2])
        bones = np.zeros((frames, k, equations.bones.shape[-1]))
        bones[:, :-1] = equations.bones[:, : k - 1]
        chain = _Chain(*series.terms(objective.times))
        by_bones = chain.totals(bones)
        matrix = chain.matrix(hessian[:, :k, :k]) - by_bones @ by_bones.T / frames
        right = chain.totals(gradient[:, :k, None])[:, 0]
        coupling = chain.vectors(hessian[:, :k, k:]).reshape(-1, frames * CAMERA_UNKNOWNS)
        prior = np.zeros(len(matrix))
        prior[: objective.prior.size] = objective.prior.ravel()
        np.einsum('ii->i', matrix)[:] += prior
        right[: objective.prior.size] += (objective.prior * series.coefficients).ravel()

        scaled = np.exp(cameras.log_scale)[:, None, None] * cameras.rotation
        jacobian = _by_camera(np.swapaxes(scaled, -1, -2))
        pull = (jacobian * objective.pull(scaled[:, :2])[..., None]).sum(axis=(1, 2))
        tilt = _tilt_by_camera(cameras.rotation[:, :, 2])
        pull += objective.level * (tilt * cameras.rotation[:, ::2, 2, None]).sum(axis=1)
        seen = hessian[:, k:, k:]
        rows = jacobian.reshape(frames, 6, CAMERA_UNKNOWNS)
        stiff = objective.roughness[0, :, None, None] * (np.swapaxes(rows, -1, -2) @ rows)
        on_diagonal = stiff + objective.level * (np.swapaxes(tilt, -1, -2) @ tilt)
        camera_prior = _camera_prior(on_diagonal, rows, objective.roughness)
        band = camera_prior.copy(order='F')
        for row, column in zip(*np.tril_indices(CAMERA_UNKNOWNS), strict=True):
            band[row - column, column::CAMERA_UNKNOWNS] += seen[:, row, column]
        return Reduced(
            matrix,
            right,
            prior,
            coupling,
            band,
            (gradient[:, k:] + pull).ravel(),
            camera_prior,
            seen,
            seen + on_diagonal,
            (len(series.coefficients) + 1, k),
        )

    def absorbed(self) -> float:
        """How many coordinates the unknowns fit away: series and cameras each with the other held."""
        n = len(self.matrix)
        series = n - np.trace(np.linalg.solve(self.matrix + NO_INFORMATION * np.eye(n), np.diag(self.prior)))
        held = self.own + NO_INFORMATION * np.eye(CAMERA_UNKNOWNS)
        cameras = np.einsum('nii->', np.linalg.solve(held, self.seen))
        return float(series + cameras + 2 * len(self.seen))

    def volume(self) -> float:
        """Log determinant of the cameras' matrix over that of their prior."""
        return _log_determinant(self.band) - _log_determinant(self.camera_prior)

    def step(self, damping: float) -> tuple[Array, Array] | None:
        """(P + 1, K + 1) step of the series and (N, 4) of the cameras, or None where it cannot be had."""
        band = self.band.copy(order='F')
        band[0] = band[0] * (1 + damping) + NO_INFORMATION
        factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
        if info:
            return None
        right = np.concatenate([self.coupling, self.camera_gradient[None]])
        forward, _ = lapack.dtbtrs(factor, right.T, uplo='L', overwrite_b=1)
        by_series, by_gradient = forward[:, :-1], forward[:, -1]
        matrix = self.matrix - by_series.T @ by_series
        on_diagonal = np.einsum('ii->i', matrix)
        on_diagonal += damping * np.diag(self.matrix) + NO_INFORMATION
        try:
            reduced = cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return None
        step = -cho_solve(reduced, self.gradient - by_series.T @ by_gradient, check_finite=False)
        back = -(by_gradient + by_series @ step)
        cameras, _ = lapack.dtbtrs(factor, back[:, None], uplo='L', trans='T')
        p, k = self.shape
        omega = np.broadcast_to(step[(p - 1) * k :], k)
        return np.append(step[: (p - 1) * k], omega).reshape(p, k), cameras.reshape(-1, CAMERA_UNKNOWNS)


def _log_determinant(band: Array) -> float:
    band = band.copy(order='F')
    band[0] += NO_CAMERA
    factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
    return np.inf if info else float(2 * np.log(factor[0]).sum())


@dataclass(frozen=True, eq=False)
class _Chain:
    """From frames to coefficients: d value_tl / d c_pl = terms_tlp, d value_tl / d omega = slopes_tl.

    Attributes:
        terms: (N, K, P), or (N, 1, P) where all share one omega.
        slopes: (N, K).
    """

    terms: Array
    slopes: Array

    def vectors(self, by_frame: Array) -> Array:
        """(N, K, R) -> (G, N, R)."""
        frames, _, count = by_frame.shape
        turned = np.swapaxes(by_frame, 0, 1)
        by_terms = np.transpose(self.terms, (2, 1, 0))[..., None] * turned
        by_omega = self.slopes.T[..., None] * turned
        if self.terms.shape[1] == 1:
            by_omega = by_omega.sum(axis=0, keepdims=True)
        return np.concatenate([by_terms.reshape(-1, frames, count), by_omega])

    def totals(self, by_frame: Array) -> Array:
        """(N, K, R) -> (G, R), summed over the frames."""
        if self.terms.shape[1] > 1:
            return np.asarray(self.vectors(by_frame).sum(axis=1))
        frames, _, count = by_frame.shape
        by_terms = self.terms[:, 0].T @ by_frame.reshape(frames, -1)
        by_omega = self.slopes.reshape(1, -1) @ by_frame.reshape(-1, count)
        return np.concatenate([by_terms.reshape(-1, count), by_omega])

    def matrix(self, by_frame: Array) -> Array:
        """(N, K, K) symmetric -> (G, G), summed over the frames."""
        frames, k, _ = by_frame.shape
        if self.terms.shape[1] > 1:
            columns = np.concatenate([self.terms, self.slopes[..., None]], axis=-1)
            pairs = np.einsum('nlp,nlm,nmq->plqm', columns, by_frame, columns, optimize=True)
            return np.asarray(pairs.reshape(columns.shape[-1] * k, -1))
        terms = self.terms[:, 0]
        p = terms.shape[1]
        products = (terms[:, :, None] * terms[:, None]).reshape(frames, -1)
        blocks = (products.T @ by_frame.reshape(frames, -1)).reshape(p, p, k, k)
        turned = (by_frame @ self.slopes[..., None])[..., 0]
        out = np.empty((p * k + 1, p * k + 1))
        out[:-1, :-1] = np.swapaxes(blocks, 1, 2).reshape(p * k, p * k)
        out[-1, :-1] = out[:-1, -1] = (terms.T @ turned).ravel()
        out[-1, -1] = (turned * self.slopes).sum()
        return out


def _with_heading(hessian: Array, gradient: Array, axis: Array) -> tuple[Array, Array]:
    """A frame's equations (N, K + 4) with the turn about the vertical `axis` (N, 3) as unknown K + 1."""
    frames, n = gradient.shape
    k = n - CAMERA_UNKNOWNS
    into = np.zeros((frames, n, n + 1))
    into[:, range(k), range(k)] = 1.0
    into[:, range(k, n), range(k + 1, n + 1)] = 1.0
    into[:, k : k + 3, k] = axis
    turned = np.swapaxes(into, -1, -2)
    return turned @ hessian @ into, (turned @ gradient[..., None])[..., 0]


def _by_camera(columns: Array) -> Array:
    """(N, 3, 3) columns of s C -> (N, 2, 3, 4) derivatives of M by rotation vector and log scale."""
    x, y, z = np.moveaxis(columns, -1, 0)
    none = np.zeros_like(x)
    return np.stack([np.stack([none, z, -y, x], axis=-1), np.stack([-z, none, x, y], axis=-1)], axis=1)


def _tilt_by_camera(up: Array) -> Array:
    """(N, 3) image of the vertical -> (N, 2, 4) derivatives of its x and z by rotation vector and log scale."""
    x, y, z = up.T
    none = np.zeros_like(x)
    return np.stack([np.stack([none, z, -y, none], axis=-1), np.stack([y, -x, none, none], axis=-1)], axis=1)


def _camera_prior(on_diagonal: Array, jacobian: Array, rough: Array) -> Array:
    """(12, N 4) lower band storage: blocks `on_diagonal` (N, 4, 4), below them M's, by `jacobian` (N, 6, 4)."""
    frames, n, _ = on_diagonal.shape
    transposed = np.swapaxes(jacobian, -1, -2)
    columns = np.zeros((frames, n, 4 * n))  # each column from its block's first row down, and room to shift it
    columns[:, :, :n] = on_diagonal
    for below in (1, 2):
        block = transposed[:-below] @ jacobian[below:]
        columns[: max(frames - below, 0), :, n * below : n * (below + 1)] = (
            rough[below, :-below, None, None] * block
        )
    c = np.arange(n)[:, None]
    return np.ascontiguousarray(columns[:, c, c + np.arange(3 * n)].reshape(frames * n, 3 * n)).T
