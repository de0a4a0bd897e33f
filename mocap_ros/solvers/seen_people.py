# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person as a camera sees them, at any times, and how far the clocks of two cameras are apart.

    v_tj = |d(x_tj - r_t) / dt|,    z(lag) = sqrt(T) c(lag),    c(lag) = corr_tj(v_tj, v'_(t+lag)j)

with x the joints, r the root, v their speeds less the means, outliers clipped, averaged over `SMOOTHING_S`, and T
the seconds that overlap at a lag. The highest maxima of z are the likeliest lags, interpolated by parabolas.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array, Mask
from mocap_ros.config import TrackerConfig
from mocap_ros.geometry.interpolation import find_covered, interpolate_linearly
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import CORE_COUNT, HIPS, find_roots
from mocap_ros.solvers.observed_window import observe_sequence

JOINT_STD_M = 0.08  # m; of a joint whose deviation is not known: whole sequences err by 0.05 to 0.07 m in the mean
# 1, of the distance, and m across the line of sight: deviations of a root whose covariance is not known, by a body
# height of 4 % and what the pose adds
DISTANCE_SHARE, ACROSS_M = 0.06, 0.03
STEP_S = 1 / 30  # s, between the speeds that are correlated
SMOOTHING_FRAMES = 5  # steps, longer than the noise of joints lasts and shorter than a swing of an arm
CLIPPED_PERCENTILE = 97  # %; faster joints are often detected wrongly
MIN_OVERLAP_S, MIN_OVERLAP_SHARE = 3.0, 0.8  # s, or of the shorter recording: over less, some lag always fits
MAX_LAGS = 3  # lags that are tried; the cycles of a walk look alike
MIN_NORM = 1e-6  # 1; share of the largest norm below which nothing moves


class ClockOffset(NamedTuple):
    """A likely offset in s, to be added to the times of the second person's camera, and its correlation c."""

    offset: float
    correlation: float


class SeenPerson(NamedTuple):
    """One person at N times in s as a camera sees them, in its optical frame; NaN where not known."""

    times: Array
    joints: Array  # (N, 15, 3) m
    std: Array  # (N, 15) m, of the joints
    root_covariance: Array  # (N, 3, 3) m^2
    rays: Array  # (N, 15, 2) x / z and y / z of the joints that are seen
    number: Array  # (N,) of the person among those of all cameras

    @property
    def roots(self) -> Array:
        """(N, 3) m, midway between the hips."""
        return find_roots(self.joints)

    @property
    def headings(self) -> Array:
        """(N,) rad, how the hips are turned about the vertical of a level camera."""
        left = self.joints[:, HIPS[0]] - self.joints[:, HIPS[1]]
        return np.arctan2(left[:, 2], left[:, 0])

    @property
    def about_root(self) -> Array:
        """(N, 15, 3) m, the joints about the root."""
        return self.joints - self.roots[:, None]

    @staticmethod
    def of(person: PoseSequence, number: int, config: TrackerConfig) -> SeenPerson:
        """Return a person with the lines of sight of the keypoints, or of the joints where there are none."""
        joints, std = person.core, person.joint_std[:, :CORE_COUNT]
        if person.sequence is None:
            rays, is_seen = joints[..., :2] / joints[..., 2:], ~person.inferred[:, :CORE_COUNT]
        else:
            observed = observe_sequence(replace(person.sequence, calibration=person.intrinsics), config)
            rays, is_seen = observed.rays, observed.evidence > 0
        roots = find_roots(joints)
        squares = roots[:, :, None] * roots[:, None]  # distance^2 u u^T with u the direction
        distance2 = np.trace(squares, axis1=1, axis2=2)[:, None, None]
        assumed = DISTANCE_SHARE**2 * squares + ACROSS_M**2 * (np.eye(3) - squares / distance2)
        known = np.isfinite(person.root_covariance).all(axis=(1, 2), keepdims=True)
        return SeenPerson(
            person.times,
            joints,
            np.where(np.isfinite(std), std, JOINT_STD_M),
            np.where(known, person.root_covariance, assumed),
            np.where(is_seen[..., None], rays, np.nan),
            np.full(len(person), float(number)),
        )

    def select(self, samples: Mask | slice) -> SeenPerson:
        """Return the person at some of the times."""
        return SeenPerson(*(values[samples] for values in self))

    def at(self, times: Array) -> SeenPerson:
        """Return the person at other times, interpolated; NaN outside and in longer gaps (`find_covered`)."""
        columns = [interpolate_linearly(times, self.times, values) for values in self[1:]]
        for column in columns:
            column[~find_covered(times, self.times)] = np.nan
        return SeenPerson(times, *columns)

    def measure_speeds(self) -> Array:
        """Return the speeds v (N, 15) in m/s every `STEP_S` from the first time on; 0 where not known."""
        about = self.at(np.arange(self.times[0], self.times[-1], STEP_S)).about_root
        speeds = np.linalg.norm(np.diff(about, axis=0), axis=-1) / STEP_S
        known = speeds[np.isfinite(speeds).all(axis=1)]
        if not len(known):
            return np.zeros((1, CORE_COUNT))
        speeds = np.minimum(speeds, np.percentile(known, CLIPPED_PERCENTILE, axis=0)) - known.mean(axis=0)
        kernel = np.full(SMOOTHING_FRAMES, 1 / SMOOTHING_FRAMES)
        return np.stack([np.convolve(np.nan_to_num(column), kernel, 'same') for column in speeds.T], axis=1)


def find_clock_offsets(first: SeenPerson, other: SeenPerson) -> list[ClockOffset]:
    """Return the likeliest offsets between the clocks of two cameras, if they see one person, the best first."""
    a, b = first.measure_speeds(), other.measure_speeds()
    count, shorter = len(a) + len(b) - 1, min(len(a), len(b))
    factors = (a, b), (a * a, np.ones_like(b)), (np.ones_like(a), b * b)
    product, own, others = (
        np.fft.irfft(np.fft.rfft(x, count, axis=0) * np.fft.rfft(y[::-1], count, axis=0), count, axis=0).sum(
            axis=1
        )
        for x, y in factors
    )
    norm = np.sqrt(own.clip(0) * others.clip(0))
    correlation = product / np.maximum(norm, MIN_NORM * max(float(norm.max()), MIN_NORM))
    steps = np.arange(1, count + 1)
    overlap = np.minimum(steps, steps[::-1]).clip(max=shorter)
    z = np.sqrt(overlap) * correlation
    z[overlap < min(MIN_OVERLAP_S / STEP_S, MIN_OVERLAP_SHARE * shorter)] = -np.inf
    peaks = np.flatnonzero((z[1:-1] >= z[:-2]) & (z[1:-1] > z[2:]) & (correlation[1:-1] > 0)) + 1
    found = []
    for peak in peaks[np.argsort(-z[peaks])][:MAX_LAGS].tolist():
        before, top, after = correlation[peak - 1 : peak + 2].tolist()
        bend = before - 2 * top + after
        lag = peak - (len(b) - 1) + (0.5 * (before - after) / bend if bend < 0 else 0.0)
        found.append(ClockOffset(float(first.times[0] - other.times[0]) + lag * STEP_S, top))
    return found
