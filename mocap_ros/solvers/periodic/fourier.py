"""Harmonic functions of time, and the first ones through the weights of a non-periodic reconstruction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig

Array = NDArray[np.float64]

CADENCES = (0.5, 2.2)
CADENCE_STEP = 0.02
FEWEST_CYCLES = 0.8
ANOTHER_CADENCE = 0.25
RIDGE = 0.2
CONSTANT_SHARE, HARMONIC_SHARE = 0.4, 0.4


@dataclass(frozen=True, eq=False)
class Series:
    """Harmonic functions of time, one a base pose and a last one for the heading.

    Attributes:
        coefficients: (P, K + 1) m, heading rad; rows constant (unless `sines`), cos, sin, cos 2, sin 2, ...
        omega: (K + 1,) rad/s, all equal unless `sines`.
        sines: the paper's form.
        origin: s, where the phase is zero.
    """

    coefficients: Array
    omega: Array
    sines: bool
    origin: float

    def terms(self, times: Array) -> tuple[Array, Array]:
        """(N, K + 1, P) values of the terms at these times (s), or (N, 1, P) of a shared omega, and their slopes.

        The slopes (N, K + 1) are derivatives of the functions by omega.
        """
        t = (times - self.origin)[:, None, None]
        harmonics = 1 if self.sines else len(self.coefficients) // 2
        h = np.arange(1, harmonics + 1)
        omega = self.omega if self.sines else self.omega[:1]
        angle = omega[:, None] * t * h
        cos, sin = np.cos(angle), np.sin(angle)
        pairs = np.stack([cos, sin], axis=-1).reshape(*angle.shape[:2], -1)
        slopes = np.stack([-h * t * sin, h * t * cos], axis=-1).reshape(*angle.shape[:2], -1)
        if not self.sines:
            pairs = np.concatenate([np.ones_like(pairs[..., :1]), pairs], axis=-1)
            slopes = np.concatenate([np.zeros_like(slopes[..., :1]), slopes], axis=-1)
        return pairs, self._sum(slopes)

    def _sum(self, terms: Array) -> Array:
        if self.sines:
            return np.asarray(np.einsum('nkp,pk->nk', terms, self.coefficients))
        return np.asarray(terms[:, 0] @ self.coefficients)

    def values(self, times: Array) -> Array:
        """(N, K + 1) weights and heading at these times."""
        return self._sum(self.terms(times)[0])

    def theta(self, times: Array) -> Array:
        """(N, K) m, weights at these times."""
        return self.values(times)[:, :-1]

    def heading(self, times: Array) -> Array:
        """(N,) rad, turn of the body within its stride."""
        return self.values(times)[:, -1]

    def moved(self, step: Array) -> Series:
        """After a step (P + 1, K + 1) of coefficients and, last, omega."""
        limit = 0.1 * self.omega
        return replace(
            self,
            coefficients=self.coefficients + step[:-1],
            omega=self.omega + np.clip(step[-1], -limit, limit),
        )


def first_series(theta: Array, times: Array, config: SolverConfig, unlike: float | None = None) -> Series:
    """Series fitted to the weights (F, K) of a non-periodic reconstruction, the likeliest cadence of a scan.

    Components count by their variance, that is as they move the body. Cadences near `unlike`, rad/s, are left out.
    """
    span = max(float(np.ptp(times)), 1e-3)
    lowest = min(max(CADENCES[0], FEWEST_CYCLES / span), CADENCES[1])
    scanned = 2 * np.pi * np.arange(lowest, CADENCES[1] + CADENCE_STEP / 2, CADENCE_STEP)
    if unlike is not None and (rest := scanned[np.abs(np.log(scanned / unlike)) > ANOTHER_CADENCE]).size:
        scanned = rest
    sines, k = config.paper_sines, theta.shape[1]
    origin = float(times.mean())
    rows = 2 if sines else 2 * config.harmonics + 1
    terms = _scan(scanned, times - origin, rows, sines)  # (C, F, P)
    ridge = RIDGE * len(times) * np.diag(1 / shares(rows, sines))
    cross = np.swapaxes(terms, -1, -2)
    fits = np.linalg.solve(cross @ terms + ridge, cross @ theta)  # (C, P, K)
    # least squares with a ridge: the misfit and the ridge's cost together are |theta|^2 less this
    explained = (fits * (cross @ theta)).sum(axis=1)
    best = explained.argmax(axis=0) if sines else np.full(k, explained.sum(axis=1).argmax())
    coefficients = np.stack([fits[b, :, i] for i, b in enumerate(best)], axis=-1)
    still = np.zeros((rows, 1))
    omega = scanned[np.append(best, best[0])]
    return Series(np.concatenate([coefficients, still], axis=1), omega, sines, origin)


def _scan(omega: Array, times: Array, rows: int, sines: bool) -> Array:
    """(C, F, P) terms of every omega."""
    angle = omega[:, None, None] * times[:, None] * np.arange(1, rows // 2 + 1)
    pairs = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(*angle.shape[:2], -1)
    return pairs if sines else np.concatenate([np.ones_like(pairs[..., :1]), pairs], axis=-1)


def shares(rows: int, sines: bool) -> Array:
    """(P,) share of a weight's variance that each term has, from walks and runs; a pair of cos and sin has one."""
    if sines:
        return np.ones(2)
    harmonic = HARMONIC_SHARE / np.arange(1, rows // 2 + 1) ** 2
    return np.append(CONSTANT_SHARE, np.repeat(harmonic, 2))
