"""The periodic model: base-pose weights as harmonic functions of time (TPAMI 2016, section 3.3).

A weight is a Fourier series with a constant term and `harmonics` harmonics of one fundamental that all base poses
share,

    theta_l(t) = c_l0 + sum_h a_lh cos(h omega t) + b_lh sin(h omega t),

or, with `paper_sines`, the paper's form (eq. 17): one sine a base pose, each with its own omega, no constant. The
objective is that of `nonperiodic` without smoothness; so are its derivatives by each frame's weights and camera,
from which the chain rule gives those by the coefficients. In each Levenberg-Marquardt step the cameras, a
block-tridiagonal system of 4 unknowns a frame, are eliminated, which leaves a dense one of (2 H + 1) K + 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from mocap_ros import nonperiodic
from mocap_ros.base_poses import BasePoses
from mocap_ros.block_tridiagonal import factor
from mocap_ros.config import SolverConfig
from mocap_ros.nonperiodic import CAMERA_UNKNOWNS, NormalEquations, Problem, State
from mocap_ros.reconstruction import Reconstruction, Start, Window

Array = NDArray[np.float64]

CADENCES = (0.5, 2.2)
CADENCE_STEP = 0.02
FEWEST_CYCLES = 0.8
FIRST_ITERATIONS = 12
RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class PeriodicReconstruction(Reconstruction):
    """A reconstruction under the periodic model.

    Attributes:
        cadence: Hz, full cycles (two steps of a walk).
        series: coefficients and frequencies.
    """

    cadence: float
    series: Series


@dataclass(frozen=True, eq=False)
class Series:
    """Harmonic functions of time, one a base pose.

    Attributes:
        coefficients: (P, K) m; rows constant (unless `sines`), cos, sin, cos 2, sin 2, ...
        omega: (K,) rad/s, all equal unless `sines`.
        sines: the paper's form.
        origin: s, where the phase is zero.
    """

    coefficients: Array
    omega: Array
    sines: bool
    origin: float

    def terms(self, times: Array) -> tuple[Array, Array]:
        """(N, K, P) values of the terms at these times (s), and (N, K) derivatives of theta by omega."""
        t = (times - self.origin)[:, None, None]
        harmonics = 1 if self.sines else (len(self.coefficients) - 1) // 2
        h = np.arange(1, harmonics + 1)
        angle = self.omega[None, :, None] * t * h
        cos, sin = np.cos(angle), np.sin(angle)
        pairs = np.stack([cos, sin], axis=-1).reshape(*angle.shape[:2], -1)
        slopes = np.stack([-h * t * sin, h * t * cos], axis=-1).reshape(*angle.shape[:2], -1)
        if not self.sines:
            pairs = np.concatenate([np.ones_like(pairs[..., :1]), pairs], axis=-1)
            slopes = np.concatenate([np.zeros_like(slopes[..., :1]), slopes], axis=-1)
        return pairs, np.einsum('nkp,pk->nk', slopes, self.coefficients)

    def theta(self, times: Array) -> Array:
        """(N, K) weights at these times."""
        return np.einsum('nkp,pk->nk', self.terms(times)[0], self.coefficients)

    def moved(self, step: Array) -> Series:
        """After a step (P + 1, K) of coefficients and, last, omega."""
        limit = 0.1 * self.omega
        return replace(
            self,
            coefficients=self.coefficients + step[:-1],
            omega=self.omega + np.clip(step[-1], -limit, limit),
        )


def solve(windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> tuple[PeriodicReconstruction, ...]:
    """Reconstruct sequences under the periodic model.

    Args:
        windows: the sequences; each should hold a cycle or more. Times may be irregular.
        model: base poses of a periodic motion.
        config: weights of the terms, `harmonics`, `paper_sines`.

    Raises:
        InputError: a window without four seen joints in any frame.
    """
    model = model.truncated(config.components)
    short = replace(config, max_iterations=min(FIRST_ITERATIONS, config.max_iterations))
    begun = nonperiodic.solve(windows, model, short)
    return tuple(_solve_one(w, b, model, config) for w, b in zip(windows, begun, strict=True))


def _solve_one(
    window: Window, begun: Reconstruction, model: BasePoses, config: SolverConfig
) -> PeriodicReconstruction:
    rigid = replace(config, smooth_weight=0.0)
    unit = window.unit or float(np.median(begun.cameras.scale))
    problem = Problem.build([window], np.array([unit]), model, rigid)
    noise = np.maximum(np.array([window.noise or begun.noise]), config.noise_floor)
    if config.adapt_noise:
        problem = problem.under_noise(noise)
    series = first_series(begun.theta, window.times, config)
    start = Start(series.theta(window.times), begun.cameras)
    state = nonperiodic.initial_state(problem, [start], np.array([unit]))
    for _ in range(2):
        state = problem.best_translation(state)
    if config.adapt_noise and window.noise is None:
        rough = replace(config, tolerance=nonperiodic.NOISE_ROUND_TOLERANCE)
        for _ in range(2):
            series, state, _, _ = _levenberg_marquardt(problem, series, state, window.times, rough)
            noise = np.maximum(problem.noise(state), config.noise_floor)
            problem = problem.under_noise(noise)
    series, state, history, converged = _levenberg_marquardt(problem, series, state, window.times, config)
    result = nonperiodic.result(problem, 0, window, unit, state, history, converged)
    plain = {f.name: getattr(result, f.name) for f in fields(Reconstruction)}
    cadence = float(np.average(series.omega, weights=(series.coefficients**2).sum(axis=0)) / (2 * np.pi))
    return PeriodicReconstruction(**plain, cadence=cadence, series=series)


def first_series(theta: Array, times: Array, config: SolverConfig) -> Series:
    """Series fitted to the weights (F, K) of a non-periodic reconstruction, the best cadence of a scan.

    Components count by their variance, that is as they move the body.
    """
    span = max(float(np.ptp(times)), 1e-3)
    lowest = min(max(CADENCES[0], FEWEST_CYCLES / span), CADENCES[1])
    scanned = 2 * np.pi * np.arange(lowest, CADENCES[1] + CADENCE_STEP / 2, CADENCE_STEP)
    sines, k = config.paper_sines, theta.shape[1]
    origin = float(times.mean())
    rows = 2 if sines else 2 * config.harmonics + 1
    misfits, fits = [], []
    for omega in scanned:
        series = Series(np.zeros((rows, 1)), np.full(1, omega), sines, origin)
        terms = series.terms(times)[0][:, 0]
        normal = terms.T @ terms + RIDGE * len(times) * np.eye(rows)
        coefficients = np.linalg.solve(normal, terms.T @ theta)
        fits.append(coefficients)
        misfits.append(((terms @ coefficients - theta) ** 2).sum(axis=0))
    best = np.argmin(misfits, axis=0) if sines else np.full(k, np.argmin(np.sum(misfits, axis=1)))
    coefficients = np.stack([fits[b][:, i] for i, b in enumerate(best)], axis=-1)
    return Series(coefficients, scanned[best], sines, origin)


def _levenberg_marquardt(
    problem: Problem, series: Series, state: State, times: Array, config: SolverConfig
) -> tuple[Series, State, list[float], bool]:
    cost = float(problem.cost(state)[0])
    history = [cost]
    damping = nonperiodic.WARM_DAMPING
    system = _Reduced.build(problem.normal_equations(state), series, times, len(times))
    for _ in range(config.max_iterations):
        global_step, camera_step = system.step(damping)
        new_series = series.moved(global_step)
        padded = np.concatenate([np.zeros_like(state.theta), camera_step], axis=1)
        tried = replace(state.moved(padded), theta=new_series.theta(times))
        tried = problem.best_translation(tried)
        new = float(problem.cost(tried)[0])
        if new < cost:
            gained, cost, series, state = cost - new, new, new_series, tried
            history.append(cost)
            damping = max(damping * nonperiodic.ACCEPTED, nonperiodic.LEAST_DAMPING)
            if gained <= config.tolerance * cost:
                return series, state, history, True
            system = _Reduced.build(problem.normal_equations(state), series, times, len(times))
        else:
            damping *= nonperiodic.REJECTED
            if damping > nonperiodic.MOST_DAMPING:
                return series, state, history, True
    return series, state, history, False


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Normal equations in the series' unknowns (flattened (P + 1, K), or with one shared omega) and cameras."""

    matrix: Array
    gradient: Array
    coupling: Array
    cameras: Array
    cameras_below: Array
    camera_gradient: Array
    shared_omega: bool
    shape: tuple[int, int]

    @staticmethod
    def build(equations: NormalEquations, series: Series, times: Array, frames: int) -> _Reduced:
        """The chain rule from each frame's weights to the series."""
        terms, by_omega = series.terms(times)
        k = by_omega.shape[1]
        columns = np.concatenate([terms, by_omega[..., None]], axis=-1)  # (N, K, P + 1)
        p = columns.shape[-1]
        theta_block = equations.diagonal[:, :k, :k]
        # sum_t columns[t, l, p] * H[t, l, m] * columns[t, m, q], as one product a pair (l, m)
        left = np.transpose(columns, (1, 2, 0))[:, None] * np.transpose(theta_block, (1, 2, 0))[:, :, None]
        matrix = left @ np.transpose(columns, (1, 0, 2))[None]  # (K, K, P + 1, P + 1)
        matrix = np.transpose(matrix, (2, 0, 3, 1)).reshape(p * k, p * k)
        gradient = np.einsum('nlp,nl->pl', columns, equations.gradient[:, :k]).ravel()
        coupling = np.einsum('nlp,nlc->plnc', columns, equations.diagonal[:, :k, k:])
        coupling = coupling.reshape(p * k, frames * CAMERA_UNKNOWNS)
        bones = np.einsum('nlp,nlb->plb', columns, equations.bones[:, :k]).reshape(p * k, -1)
        matrix -= bones @ bones.T / frames
        shared = not series.sines
        if shared:
            fold = np.zeros((p * k, (p - 1) * k + 1))
            np.fill_diagonal(fold, 1.0)
            fold[(p - 1) * k :, -1] = 1.0
            matrix, gradient, coupling = fold.T @ matrix @ fold, fold.T @ gradient, fold.T @ coupling
        return _Reduced(
            matrix,
            gradient,
            coupling,
            equations.diagonal[:, k:, k:],
            equations.below[:, k:, k:],
            equations.gradient[:, k:],
            shared,
            (p, k),
        )

    def step(self, damping: float) -> tuple[Array, Array]:
        """(P + 1, K) step of the series and (N, 4) of the cameras, the cameras eliminated first."""
        frames, n = self.camera_gradient.shape
        cameras = self.cameras.copy()
        on_diagonal = np.einsum('nii->ni', cameras)
        on_diagonal *= 1 + damping
        on_diagonal += 1e-12
        banded = factor(cameras, self.cameras_below, 2 * n - 1)
        if banded is None:
            raise np.linalg.LinAlgError('camera block not positive definite')
        right = np.concatenate([self.coupling, self.camera_gradient.reshape(1, -1)]).T
        solved = banded.solve(right.reshape(frames, n, -1)).reshape(frames * n, -1)
        by_global, by_gradient = solved[:, :-1], solved[:, -1]
        matrix = self.matrix + np.diag(damping * np.diag(self.matrix) + 1e-12)
        reduced = cho_factor(matrix - self.coupling @ by_global, lower=True)
        step = -cho_solve(reduced, self.gradient - self.coupling @ by_gradient)
        camera_step = -(by_gradient + by_global @ step).reshape(frames, n)
        p, k = self.shape
        if self.shared_omega:
            step = np.concatenate([step[:-1], np.full(k, step[-1])])
        return step.reshape(p, k), camera_step
