# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The floor on which people stand, and their sizes, by the height of the camera and by each other.

A body r times as large as the assumed one, and r times as far away, has the same image. In the units of the
assumed body of person i the camera is g_i = c / r_i over the floor. Feet that stand, with the probability p and so
to the share s = max(2 p - 1, 0), are on it at the height h:

    0 = g_i + u.(f_it + q_it x_it) - h_it,    f_it = sum_j s_itj f_itj / sum_j s_itj,    h_it likewise

with u the vertical and q_it the share by which the hips x_it are farther away than the solution has them; it
corrects the depth, which a single image shows worst. The least squares of these errors over `HEIGHT_STD_M`, robust
and each for the time that its frame stands for, with the priors

    u ~ (u_0, s_u),    c ~ (c_0, s_h),    g_i ~ (c, s_0 c),    sum_t dt / (T S^2) (q_t^2 + T^4 (d^2 q_t / dt^2)^2)

has a band for the q of each person and a border for u, g and c. Where the height of the camera is not known, c has
no prior: one person has r = 1, and of several each has the size with which all stand on one floor, as far as the
vertical is known. Both points of a foot are one error, since it is the way of a person over the floor that shows
how it is tilted, and not the pose, which leans with the vertical that was found by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.level import MAX_CERTAIN_STD, Floor
from mocap_ros.models.upward_direction import Stances
from mocap_ros.skeleton import CORE_COUNT, find_roots
from mocap_ros.solvers.footing import ANKLES, HEELS_AND_TOES

# m; h of heels, toes and ankles of training persons where they seem to stand, which is too early and too late
HEEL_M, TOE_M, ANKLE_M = 0.027, 0.042, 0.083
HEIGHT_STD_M = 0.04  # m; of these heights, with the errors of the image
EVIDENCE_S = 0.5  # s; frames within it have the same error
DEPTH_SHARE, DEPTH_S = 0.04, 0.5  # 1 and s; S and T
FOCAL_SHARE = 0.2  # 1; usual focal lengths are 0.6 to 0.9 of the longer side of the image, the nominal one is 0.75
POSE_SHARE = 0.04  # 1; of the size, measured on training persons of known height seen by four detectors
SIZE_RANGE = 0.4, 1.3  # 1; of r, from children of 0.7 m to adults of 2.2 m; another is that of a wrong height
MAX_STEP_S = 0.2  # s; longest time that one frame stands for
MIN_STANDING_S = 0.5  # s; less shows no floor
MIN_CAMERA_HEIGHT_M = 0.1  # m; a floor nearer below the camera cannot be seen
ITERATIONS = 6  # of Gauss-Newton, in which the robust weights settle


class Stander(NamedTuple):
    """A person who may stand on the floor, in F frames."""

    joints: Array  # (F, J, 3) m, of `CMU15` or `BODY26` in a camera that does not move; NaN where there are none
    contact: Array  # (F, 4) probabilities of `solvers.footing`; NaN where unknown
    times: Array  # (F,) s, increasing
    size_share: float  # standard deviation of the size of the body, as a share of it


class FloorFit(NamedTuple):
    """The floor, and where people are who stand on it."""

    floor: Floor
    # r of each person, of the true size to the assumed; NaN of those who show nothing
    sizes: Array
    shifts: list[Array]  # (F,) q of each person, shares of the distance

    def place(self, person: int, joints: Array) -> Array:
        """Return joints (F, J, 3) in m of a person of this size."""
        hips = find_roots(joints)
        return np.asarray(self.sizes[person] * (joints + (self.shifts[person][:, None] * hips)[:, None]))


class _Evidence:
    """What the feet of a person show: the errors of the module's formula in the K frames that are known."""

    def __init__(
        self,
        known: NDArray[np.intp],
        body: Array,
        share: Array,
        weight: Array,
        steps: Array,
        size_share: float,
    ) -> None:
        has_feet = body.shape[1] > CORE_COUNT
        share = share / np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
        self.known, self.weight, self.size_share = known, weight, size_share
        self.feet = (body[:, HEELS_AND_TOES if has_feet else ANKLES] * share[..., None]).sum(axis=1)
        self.heights = share @ np.array([HEEL_M, TOE_M, HEEL_M, TOE_M] if has_feet else [ANKLE_M] * 4)
        self.hips = find_roots(body)
        self.stiffness = _build_depth_prior(steps)
        self.shifts = np.zeros(len(known))

    @staticmethod
    def find(person: Stander) -> _Evidence | None:
        """Return what a person shows; None if that is nothing."""
        known = np.flatnonzero(np.isfinite(person.joints).all(axis=(1, 2)))
        if len(known) < 3:
            return None
        body, share = person.joints[known], np.fmax(2 * person.contact[known] - 1, 0.0)
        times = person.times[known]
        steps = np.minimum(np.diff(times, append=2 * times[-1] - times[-2]), MAX_STEP_S)
        stood = share.max(axis=1) * Stances.of(body).standing * steps
        if stood.sum() < MIN_STANDING_S:
            return None
        weight = stood / (EVIDENCE_S * HEIGHT_STD_M**2)
        return _Evidence(known, body, share, weight, steps, person.size_share)

    def find_height(self, upward: Array) -> float:
        """Return how high the camera is over feet of the assumed size."""
        return float(np.average(self.heights - self.feet @ upward, weights=self.weight))

    def reduce(self, upward: Array, tangents: Array, height: float) -> tuple[Array, Array, Array]:
        """Return normal matrix (3, 3) and slope (3,) of tilt and g without q, and the solution (K, 4) for q."""
        moved = self.feet + self.shifts[:, None] * self.hips
        error = height + moved @ upward - self.heights
        robust = self.weight / (1 + (error / (2 * HEIGHT_STD_M)) ** 2)
        by_border, by_shift = np.column_stack([moved @ tangents.T, np.ones(len(moved))]), self.hips @ upward
        matrix = self.stiffness.copy()
        matrix[2] += robust * by_shift**2
        mixed = (robust * by_shift)[:, None] * by_border
        gradient = by_shift * robust * error + _multiply(self.stiffness, self.shifts)
        solved = _solve_bands(matrix, np.column_stack([mixed, gradient]))
        normal = (robust[:, None] * by_border).T @ by_border - mixed.T @ solved[:, :3]
        return normal, by_border.T @ (robust * error) - mixed.T @ solved[:, 3], solved


def fit_floor(people: Sequence[Stander], before: Floor) -> FloorFit | None:
    """Find the floor on which people stand; None if nothing shows it.

    Args:
        people: those who are seen by a camera that does not move.
        before: the vertical, and the height of the camera if it is known.
    """
    shown = [_Evidence.find(person) for person in people] if before.tilt_std <= MAX_CERTAIN_STD else []
    evidence = [e for e in shown if e is not None]
    if not evidence:
        return None
    tangents, upward, count = np.linalg.svd(before.upward[None])[2][1:], before.upward, len(evidence)
    known_m = before.camera_height
    heights = np.array([max(e.find_height(upward), MIN_CAMERA_HEIGHT_M) for e in evidence])
    expected = float(heights.mean())
    values = np.array([0.0, 0.0, *heights, expected if known_m is None else known_m])  # tilt, g of each person, c
    covariance: Array = np.eye(3 + count)
    for _ in range(ITERATIONS):
        upward = before.upward + values[:2] @ tangents
        upward /= np.linalg.norm(upward)
        matrix, slope = np.zeros((3 + count, 3 + count)), np.zeros(3 + count)
        matrix[[0, 1], [0, 1]] = before.tilt_std**-2
        slope[:2] = values[:2] / before.tilt_std**2
        if known_m is not None:
            matrix[-1, -1], slope[-1] = before.height_std**-2, (values[-1] - known_m) / before.height_std**2
        reduced = []
        for place, seen in enumerate(evidence, 2):
            normal, own_slope, solved = seen.reduce(upward, tangents, values[place])
            at = np.array([0, 1, place])
            matrix[np.ix_(at, at)] += normal
            slope[at] += own_slope
            trust = (seen.size_share * max(float(values[-1]), MIN_CAMERA_HEIGHT_M)) ** -2
            matrix[np.ix_([place, -1], [place, -1])] += trust * np.array([[1.0, -1.0], [-1.0, 1.0]])
            slope[[place, -1]] += trust * (values[place] - values[-1]) * np.array([1.0, -1.0])
            reduced.append((at, solved))
        covariance = np.asarray(np.linalg.inv(matrix), np.float64)
        change = covariance @ slope
        values -= change
        for seen, (at, solved) in zip(evidence, reduced, strict=True):
            seen.shifts += solved[:, :3] @ change[at] - solved[:, 3]
    height = float(values[-1]) if known_m is None else known_m
    if known_m is None and not MIN_CAMERA_HEIGHT_M < height < expected / MIN_CAMERA_HEIGHT_M:
        return None
    tilt_std = math.sqrt(float(np.trace(covariance[:2, :2])) / 2)
    height_std = before.height_std if known_m is not None else math.sqrt(float(covariance[-1, -1]))
    sizes, shifts = np.full(len(people), np.nan), [np.zeros(len(person.joints)) for person in people]
    own_heights = iter(values[2:-1])
    for p, own in enumerate(shown):
        if own is not None:
            own_m = float(next(own_heights))
            sizes[p] = height / own_m if own_m > MIN_CAMERA_HEIGHT_M else math.inf
            shifts[p][own.known] = own.shifts
    return FloorFit(Floor(upward, height, tilt_std, height_std), sizes, shifts)


def _build_depth_prior(steps: Array) -> Array:
    """Return the upper bands (3, F) of the prior of q, for frames that stand for these times (F,) in s."""
    bands = np.zeros((3, len(steps)))
    weight = steps / (DEPTH_S * DEPTH_SHARE**2)
    bands[2] = weight
    second = (DEPTH_S / float(np.median(steps))) ** 2 * np.array([1.0, -2.0, 1.0])
    count = len(steps) - 2
    for i in range(3):
        for j in range(i, 3):
            bands[2 + i - j, j : j + count] += weight[1:-1] * second[i] * second[j]
    return bands


def _solve_bands(bands: Array, values: Array) -> Array:
    from scipy.linalg import solveh_banded  # 22 MB that a live tracker does not need

    return np.asarray(solveh_banded(bands, values))


def _multiply(bands: Array, values: Array) -> Array:
    """Return the product of a symmetric matrix, by its upper bands (3, F), and a vector."""
    product = bands[2] * values
    for offset in (1, 2):
        product[:-offset] += bands[2 - offset, offset:] * values[offset:]
        product[offset:] += bands[2 - offset, offset:] * values[:-offset]
    return np.asarray(product)
