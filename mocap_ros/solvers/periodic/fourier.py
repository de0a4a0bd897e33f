# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fourier series of time for the base-pose weights and the heading (TPAMI 2016, section 3.3).

    u_l(t) = c_0l + sum_h [a_hl cos(h omega (t - t0)) + b_hl sin(h omega (t - t0))],    h = 1 ... H

for l = 1 ... K (weights, m) and l = K + 1 (heading, rad), with one fundamental frequency omega (eq. 17 has one for
each) and t0 the mean of the times. They are linear in the P = 2 H + 1 coefficients, u_l(t) = sum_p terms_tp c_pl,
whose order is constant, cos, sin, cos 2, sin 2 and so on.
"""

from __future__ import annotations

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig

MIN_CADENCE_HZ = 0.5  # Hz, full cycles; the slowest walk, as `ClassifierConfig.walk_cadence`
MAX_CADENCE_HZ = 2.2  # Hz, full cycles; about that of a sprint
CADENCE_STEP_HZ = 0.02  # Hz; half a step shifts the phase over a window of 2 s by 2 % of a cycle
MIN_CYCLES = 0.8  # cycles in the window; a lower cadence would look like a drift
MIN_LOG_CADENCE_RATIO = 0.25  # a second cadence differs by a factor of 1.28, or it would end in the same minimum
RIDGE = 0.2  # weight of c^T diag(1 / share) c against the mean squared misfit; chosen on CMU walks and runs
# Shares of a weight's variance over time and persons, chosen on CMU walks and runs.
CONSTANT_SHARE = 0.4  # of the constant term
HARMONIC_SHARE = 0.4  # of the first harmonic; the h-th has 1 / h^2 of it


def fit_initial_series(theta: Array, times: Array, config: SolverConfig) -> list[tuple[Array, float]]:
    """Fit series to the weights of a non-periodic reconstruction, with the two most likely cadences of a scan.

    Returns the coefficients (P, K + 1) and omega in rad/s of each.

    For every cadence, with the diagonal ridge D = RIDGE N diag(1 / share_p), the coefficients minimise

        |theta_l - T c_l|^2 + c_l^T D c_l = |theta_l|^2 - c_l^T T^T theta_l    at  c_l = (T^T T + D)^-1 T^T theta_l

    so the best has the largest c^T T^T theta, summed over base poses. The heading begins as zero. The second
    cadence is the best of those unlike the first; it is the first if there are none.
    """
    scanned = list_scanned_frequencies(times)
    h = np.arange(1, config.harmonics + 1)
    terms = make_terms(scanned[:, None, None] * (times - times.mean())[:, None] * h)  # (C, N, P)
    fits, explained = fit_with_ridge(terms, theta, variance_shares(config.harmonics))
    total = explained.sum(axis=1)
    first = total.argmax()
    is_other = np.abs(np.log(scanned / scanned[first])) > MIN_LOG_CADENCE_RATIO
    second = np.where(is_other, total, -np.inf).argmax() if is_other.any() else first
    heading = np.zeros((terms.shape[-1], 1))
    return [(np.concatenate([fits[i], heading], axis=1), float(scanned[i])) for i in (first, second)]


def list_scanned_frequencies(times: Array) -> Array:
    """Return the frequencies (C,) in rad/s among which that of a window with these times (N,) s is searched."""
    span = max(float(np.ptp(times)), 1e-3)
    lowest = min(max(MIN_CADENCE_HZ, MIN_CYCLES / span), MAX_CADENCE_HZ)
    return 2 * np.pi * np.arange(lowest, MAX_CADENCE_HZ + CADENCE_STEP_HZ / 2, CADENCE_STEP_HZ)


def make_terms(angle: Array) -> Array:
    """Return the terms (..., 2 H + 1) 1, cos, sin, cos 2, sin 2, ... of the angles (..., H) h omega (t - t0)."""
    terms = np.ones((*angle.shape[:-1], 2 * angle.shape[-1] + 1))
    np.cos(angle, out=terms[..., 1::2])
    np.sin(angle, out=terms[..., 2::2])
    return terms


def fit_with_ridge(terms: Array, theta: Array, share: Array) -> tuple[Array, Array]:
    """Return coefficients (C, P, K) m for C frequencies, and what they explain, c^T T^T theta, (C, K) m^2."""
    ridge = RIDGE * theta.shape[0] * np.diag(1 / share)
    cross = np.swapaxes(terms, -1, -2)
    fits = np.linalg.solve(cross @ terms + ridge, cross @ theta)
    return fits, (fits * (cross @ theta)).sum(axis=1)


def variance_shares(harmonics: int) -> Array:
    """Return the share (2 H + 1,) of a weight's variance that the prior gives to each term."""
    harmonic = HARMONIC_SHARE / np.arange(1, harmonics + 1) ** 2
    return np.append(CONSTANT_SHARE, np.repeat(harmonic, 2))
