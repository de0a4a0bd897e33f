"""Fourier series of time for the base-pose weights and the heading (TPAMI 2016, section 3.3).

    u_l(t) = c_0l + sum_h [a_hl cos(h omega (t - t0)) + b_hl sin(h omega (t - t0))],    h = 1 ... H

for l = 1 ... K (weights of the base poses, m) and l = K + 1 (heading, rad), with one fundamental frequency omega
for all functions. The paper's form (eq. 17) is u_l(t) = alpha_l sin(omega_l t + phi_l) = a_l cos(omega_l t) + b_l
sin(omega_l t), with a frequency for each function and no constant. Both are linear in the P coefficients c_pl (P =
2 H + 1, or 2 for the paper's form):

    u_l(t) = sum_p terms_tlp c_pl,    d u_l(t) / d c_pl = terms_tlp
    slope_tl = d u_l(t) / d omega = sum_h h (t - t0) [b_hl cos(h omega (t - t0)) - a_hl sin(h omega (t - t0))]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig

Array = NDArray[np.float64]

MIN_CADENCE_HZ = 0.5  # Hz, full cycles; the slowest walk, as `ClassifierConfig.walk_cadence`
MAX_CADENCE_HZ = 2.2  # Hz, full cycles; about that of a sprint
CADENCE_STEP_HZ = 0.02  # Hz; half a step shifts the phase over a window of 2 s by 2 % of a cycle
MIN_CYCLES = 0.8  # cycles in the window; a lower cadence could not be told from a drift
MIN_LOG_CADENCE_RATIO = 0.25  # a second cadence differs by a factor of 1.28, or it would end in the same minimum
RIDGE = 0.2  # weight of c^T diag(1 / share) c against the mean squared misfit; chosen on CMU walks and runs
MAX_FREQUENCY_STEP = 0.1  # of omega; guards a step of the solver against leaving the cadence of its hypothesis
# Shares of a weight's variance over time and persons, chosen on CMU walks and runs.
CONSTANT_SHARE = 0.4  # of the constant term
HARMONIC_SHARE = 0.4  # of the first harmonic; the h-th has 1 / h^2 of it


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """Fourier series of K base-pose weights and, in the last column, of the heading.

    Attributes:
        coefficients: (P, K + 1) m, in the last column rad. The rows are constant, cos, sin, cos 2, sin 2, ...; the
            sine form has the rows cos and sin.
        omega: (K + 1,) rad/s, fundamental frequency of each function; all are equal except in the sine form.
        is_sine_form: True for the paper's form (eq. 17).
        origin: s, the time t0 at which the phase is zero.
    """

    coefficients: Array
    omega: Array
    is_sine_form: bool
    origin: float

    def terms(self, times: Array) -> tuple[Array, Array]:
        """Return the terms and the slopes at these times.

        Args:
            times: (N,) s.

        Returns:
            The terms (N, K + 1, P), or (N, 1, P) if all functions share one frequency, and the slopes (N, K + 1),
            derivatives of the functions with respect to their frequency.
        """
        t = (times - self.origin)[:, None, None]
        harmonics = 1 if self.is_sine_form else len(self.coefficients) // 2
        h = np.arange(1, harmonics + 1)
        omega = self.omega if self.is_sine_form else self.omega[:1]
        angle = omega[:, None] * t * h
        cos, sin = np.cos(angle), np.sin(angle)
        pairs = np.stack([cos, sin], axis=-1).reshape(*angle.shape[:2], -1)
        slopes = np.stack([-h * t * sin, h * t * cos], axis=-1).reshape(*angle.shape[:2], -1)
        if not self.is_sine_form:
            pairs = np.concatenate([np.ones_like(pairs[..., :1]), pairs], axis=-1)
            slopes = np.concatenate([np.zeros_like(slopes[..., :1]), slopes], axis=-1)
        return pairs, self._sum_terms(slopes)

    def _sum_terms(self, terms: Array) -> Array:
        """Return sum_p terms_tlp c_pl, (N, K + 1)."""
        if self.is_sine_form:
            return np.asarray(np.einsum('nkp,pk->nk', terms, self.coefficients))
        return np.asarray(terms[:, 0] @ self.coefficients)

    def evaluate(self, times: Array) -> Array:
        """Return the weights (m) and, in the last column, the heading (rad), (N, K + 1), at the times (N,) s."""
        return self._sum_terms(self.terms(times)[0])

    def evaluate_theta(self, times: Array) -> Array:
        """Return the weights at these times (N,) s, (N, K) m."""
        return self.evaluate(times)[:, :-1]

    def evaluate_heading(self, times: Array) -> Array:
        """Return the turn of the body within its stride at these times (N,) s, (N,) rad."""
        return self.evaluate(times)[:, -1]

    def with_step(self, step: Array) -> FourierSeries:
        """Return the series after a step (P + 1, K + 1) of the coefficients and, in the last row, of omega."""
        limit = MAX_FREQUENCY_STEP * self.omega
        return replace(
            self,
            coefficients=self.coefficients + step[:-1],
            omega=self.omega + np.clip(step[-1], -limit, limit),
        )


def fit_initial_series(
    theta: Array, times: Array, config: SolverConfig, excluded_omega: float | None = None
) -> FourierSeries:
    """Fit a series to the weights of a non-periodic reconstruction, with the most likely cadence of a scan.

    For every cadence on a grid the coefficients minimise, with the diagonal ridge D = RIDGE N diag(1 / share_p),

        |theta_l - T c_l|^2 + c_l^T D c_l = |theta_l|^2 - c_l^T T^T theta_l    at  c_l = (T^T T + D)^-1 T^T theta_l

    so the best cadence has the largest c^T T^T theta, summed over all base poses unless each has its own
    frequency. A base pose counts by the variance of its weight, that is, as far as it moves the body. The heading
    begins as zero.

    Args:
        theta: (N, K) m, weights.
        times: (N,) s.
        config: `paper_sines` and `harmonics` select the form of the series.
        excluded_omega: rad/s; similar frequencies are left out of the scan, unless none would remain.
    """
    span = max(float(np.ptp(times)), 1e-3)
    lowest = min(max(MIN_CADENCE_HZ, MIN_CYCLES / span), MAX_CADENCE_HZ)
    scanned = 2 * np.pi * np.arange(lowest, MAX_CADENCE_HZ + CADENCE_STEP_HZ / 2, CADENCE_STEP_HZ)
    if excluded_omega is not None:
        remaining = scanned[np.abs(np.log(scanned / excluded_omega)) > MIN_LOG_CADENCE_RATIO]
        if remaining.size:
            scanned = remaining
    is_sine_form, k = config.paper_sines, theta.shape[1]
    origin = float(times.mean())
    rows = 2 if is_sine_form else 2 * config.harmonics + 1
    terms = _scan_terms(scanned, times - origin, rows, is_sine_form)  # (C, N, P)
    ridge = RIDGE * len(times) * np.diag(1 / variance_shares(rows, is_sine_form))
    cross = np.swapaxes(terms, -1, -2)
    fits = np.linalg.solve(cross @ terms + ridge, cross @ theta)  # (C, P, K)
    explained = (fits * (cross @ theta)).sum(axis=1)  # (C, K)
    best = explained.argmax(axis=0) if is_sine_form else np.full(k, explained.sum(axis=1).argmax())
    coefficients = np.stack([fits[b, :, i] for i, b in enumerate(best)], axis=-1)
    heading = np.zeros((rows, 1))
    omega = scanned[np.append(best, best[0])]
    return FourierSeries(np.concatenate([coefficients, heading], axis=1), omega, is_sine_form, origin)


def _scan_terms(omega: Array, times: Array, rows: int, is_sine_form: bool) -> Array:
    """Return the terms (C, N, P) of every frequency (C,) rad/s at these times (N,) s."""
    angle = omega[:, None, None] * times[:, None] * np.arange(1, rows // 2 + 1)
    pairs = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(*angle.shape[:2], -1)
    return pairs if is_sine_form else np.concatenate([np.ones_like(pairs[..., :1]), pairs], axis=-1)


def variance_shares(rows: int, is_sine_form: bool) -> Array:
    """Return the share (P,) of a weight's variance that the prior gives to each of `rows` = P terms.

    The cosine and the sine of a harmonic have the same share.
    """
    if is_sine_form:
        return np.ones(2)
    harmonic = HARMONIC_SHARE / np.arange(1, rows // 2 + 1) ** 2
    return np.append(CONSTANT_SHARE, np.repeat(harmonic, 2))
