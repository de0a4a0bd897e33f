# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The paper's periodic model: one sine for each base pose, with a frequency of its own (TPAMI 2016, eq. 17).

    u_l(t) = alpha_l sin(omega_l t + phi_l) = a_l cos(omega_l (t - t0)) + b_l sin(omega_l (t - t0))

for l = 1 ... K (weights of the base poses, m) and l = K + 1 (heading, rad). The objective is minimised like that
of the package's periodic model (`mocap_ros.solvers.periodic`), from one initial series and without an estimate of
the image noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint
from mocap_ros.solvers.periodic.fourier import (
    MAX_FREQUENCY_STEP,
    FourierSeries,
    SeriesJacobian,
    fit_with_ridge,
    list_scanned_frequencies,
)
from mocap_ros.solvers.periodic.objective import HEADING_STD, PeriodicObjective
from mocap_ros.solvers.periodic.solver import (
    MAX_INITIAL_ITERATIONS,
    MIN_NOISE_FOR_HYPOTHESES,
    Search,
    measure_initial_point,
    select_most_likely,
)
from mocap_ros.solvers.stepwise import run_to_end
from mocap_ros.solvers.window import InitialValues, Reconstruction, Window

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SineSeries(FourierSeries):
    """One sine for each of K base-pose weights and, in the last column, for the heading.

    Attributes:
        coefficients: (2, K + 1) m, in the last column rad: factors of the cosine and of the sine.
        omega: rad/s, frequency of the first function.
        origin: s, the time t0 at which the phase is zero.
        frequencies: (K + 1,) rad/s, frequency of each function.
    """

    frequencies: Array

    def _angle(self, times: Array) -> tuple[Array, Array]:
        """Return the times from the origin (N, 1) s, and the angles (N, K + 1) of the functions."""
        t = (times - self.origin)[:, None]
        return t, self.frequencies * t

    def jacobian(self, times: Array) -> SineJacobian:
        t, angle = self._angle(times)
        cos, sin = np.cos(angle), np.sin(angle)
        a, b = self.coefficients
        return SineJacobian(np.stack([cos, sin], axis=-1), t * (b * cos - a * sin))

    def evaluate(self, times: Array) -> Array:
        _, angle = self._angle(times)
        return np.asarray(self.coefficients[0] * np.cos(angle) + self.coefficients[1] * np.sin(angle))

    def with_step(self, step: Array) -> SineSeries:
        """Return the series after a step (3 (K + 1),) of the flattened coefficients, then of the frequencies."""
        change = step.reshape(3, -1)
        limit = MAX_FREQUENCY_STEP * self.frequencies
        frequencies = self.frequencies + np.clip(change[2], -limit, limit)
        return SineSeries(self.coefficients + change[:2], float(frequencies[0]), self.origin, frequencies)


@dataclass(frozen=True, eq=False)
class SineJacobian(SeriesJacobian):
    """Jacobian of the functions' values by the G = 3 (K + 1) unknowns of a `SineSeries`, for all frames.

    Attributes:
        terms: (N, K + 1, 2) derivatives by the coefficients of the same function.
        slopes: (N, K + 1) derivatives by the frequency of the same function.
    """

    def _columns(self) -> Array:
        """Return the derivatives (N, K + 1, 3) of each function by its own unknowns."""
        return np.concatenate([self.terms, self.slopes[..., None]], axis=-1)

    def products(self, values: Array) -> Array:
        frames, rows, _ = values.shape
        products = values[:, :, None] * np.swapaxes(self._columns(), 1, 2)[:, None]
        return np.asarray(products.reshape(frames, rows, -1))

    def sum_products(self, values: Array) -> Array:
        return np.asarray(self.products(values).sum(axis=0))

    def sum_congruences(self, matrices: Array) -> Array:
        columns = self._columns()
        pairs = np.einsum('nlp,nlm,nmq->plqm', columns, matrices, columns, optimize=True)
        return np.asarray(pairs.reshape(3 * len(matrices[0]), -1))


def solve_with_sines(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> tuple[Reconstruction, ...]:
    """Reconstruct windows under the paper's periodic model.

    Args:
        windows: image points; each window should contain a cycle or more.
        model: base poses of a periodic motion.
        config: weights of the terms; `harmonics` and `adapt_noise` do not apply.
    """
    model = model.truncate(config.components)
    return tuple(_solve_window(window, model, config) for window in windows)


def _solve_window(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    short = replace(config, max_iterations=min(MAX_INITIAL_ITERATIONS, config.max_iterations))
    (coarse,) = joint.solve([window], model, short)
    unit = float(np.median(coarse.cameras.scale))
    objective = build_objective(window, unit, model, config)
    series = fit_initial_sines(coarse.theta, window.times)
    point = measure_initial_point(objective, series, InitialValues(coarse.theta, coarse.cameras), unit)
    search = Search(objective, point, config.max_iterations)
    if coarse.noise >= MIN_NOISE_FOR_HYPOTHESES:
        still = Search(objective.with_still_camera(config), point, search.remaining_trials)
        search = run_to_end(select_most_likely([search, still]))
    run_to_end(search.run(config.tolerance))
    iterations = config.max_iterations - search.remaining_trials
    return search.make_reconstruction(window, unit, iterations)


def build_objective(window: Window, unit: float, model: BasePoses, config: SolverConfig) -> PeriodicObjective:
    """Return the objective of a window, with one prior for both coefficients of a function; `unit` in px/m."""
    objective = PeriodicObjective.build(window, unit, model, config)
    precision = config.prior_weight * config.periodic_prior_factor / np.append(model.std, HEADING_STD) ** 2
    return replace(objective, prior=np.tile(precision, (2, 1)))


def fit_initial_sines(theta: Array, times: Array) -> SineSeries:
    """Fit sines to the weights (F, K) m of a non-periodic reconstruction, with the most likely frequency of each.

    The heading begins as zero, with the frequency of the first base pose. The formula is at `fit_initial_series`.
    """
    scanned = list_scanned_frequencies(times)
    origin = float(times.mean())
    angle = scanned[:, None] * (times - origin)
    fits, explained = fit_with_ridge(np.stack([np.cos(angle), np.sin(angle)], axis=-1), theta, np.ones(2))
    best = explained.argmax(axis=0)
    coefficients = np.append(fits[best, :, np.arange(len(best))].T, np.zeros((2, 1)), axis=1)
    frequencies = scanned[np.append(best, best[0])]
    return SineSeries(coefficients, float(frequencies[0]), origin, frequencies)
