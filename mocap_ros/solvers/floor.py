# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The floor on which a person stands, and how large the person is where the camera's height over it is known.

A body r times as large as the assumed one, and r times as far away, has the same image. In the units of the
assumed body the camera is c / r over the floor. Feet that stand, with the probability p and so to the share
s = max(2 p - 1, 0), are on it at the height h:

    0 = g + u.(f_t + q_t x_t) - h_t,    g = c / r,    f_t = sum_j s_tj f_tj / sum_j s_tj,    h_t likewise

with u the vertical and q_t the share by which the hips x_t are farther away than the solution has them; it
corrects the depth, which a single image shows worst. The least squares of these errors over `HEIGHT_STD_M`, robust
and each for the time that its frame stands for, with the priors

    u ~ (u_0, s_u),    ln g ~ (ln c, s_0),    sum_t dt / (T S^2) (q_t^2 + T^4 (d^2 q_t / dt^2)^2)

has a band for q and a border of three for u and g. Where c is not known, ln g has no prior, r is 1, and only the
floor is found. Both points of a foot are one error, since it is the way of a person over the floor that shows how
it is tilted, and not the pose, which leans with the vertical that was found by it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.level import MAX_CERTAIN_STD, Floor
from mocap_ros.models.upward_direction import find_standing
from mocap_ros.people import HIPS
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.contacts import ANKLES, HEELS_AND_TOES

Array = NDArray[np.float64]

# m; h of heels, toes and ankles of training persons where they seem to stand, which is too early and too late
HEEL_M, TOE_M, ANKLE_M = 0.027, 0.042, 0.083
HEIGHT_STD_M = 0.04  # m; of these heights, with the errors of the image
EVIDENCE_S = 0.5  # s; frames within it have the same error
DEPTH_SHARE, DEPTH_S = 0.04, 0.5  # 1 and s; S and T
POSE_SHARE = 0.04  # 1; of the size, measured on training persons of known height seen by four detectors
SIZE_RANGE = 0.75, 1.3  # 1; of r, 3.5 of its standard deviations; another is that of a wrong height of the camera
MAX_STEP_S = 0.2  # s; longest time that one frame stands for
MIN_STANDING_S = 0.5  # s; less shows no floor
MIN_CAMERA_HEIGHT_M = 0.1  # m; a floor nearer below the camera cannot be seen
ITERATIONS = 6  # of Gauss-Newton, in which the robust weights settle


class FloorFit(NamedTuple):
    """The floor, and where a person is who stands on it."""

    floor: Floor
    # r, of the true size to the assumed; 1 where the camera's height is not known, infinite where it is wrong
    size: float
    shifts: Array  # (F,) q, shares of the distance

    def place(self, joints: Array) -> Array:
        """Return joints (F, J, 3) in m of a person of this size."""
        hips = (joints[:, HIPS[0]] + joints[:, HIPS[1]]) / 2
        return np.asarray(self.size * (joints + (self.shifts[:, None] * hips)[:, None]))


def fit_floor(joints: Array, contact: Array, times: Array, before: Floor, size_share: float) -> FloorFit | None:
    """Find the floor on which a person stands; None if nothing shows it.

    Args:
        joints: (F, J, 3) m, of `CMU15` or `BODY26` in a camera that does not move; NaN where there are none.
        contact: (F, 4) probabilities of `solvers.contacts`; NaN where unknown.
        times: (F,) s, increasing.
        before: the vertical, and the height of the camera if it is known.
        size_share: standard deviation of the size of the body, as a share of it.
    """
    from scipy.linalg import solveh_banded  # 22 MB that a live tracker does not need

    known = np.flatnonzero(np.isfinite(joints).all(axis=(1, 2)))
    if len(known) < 3 or not before.tilt_std <= MAX_CERTAIN_STD:
        return None
    body, share = joints[known], np.fmax(2 * contact[known] - 1, 0.0)
    steps = np.minimum(np.diff(times[known], append=2 * times[known[-1]] - times[known[-2]]), MAX_STEP_S)
    stood = share.max(axis=1) * find_standing(body) * steps
    if stood.sum() < MIN_STANDING_S:
        return None
    weight = stood / (EVIDENCE_S * HEIGHT_STD_M**2)
    share = share / np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
    has_feet = joints.shape[1] > CORE_COUNT
    feet = (body[:, HEELS_AND_TOES if has_feet else ANKLES] * share[..., None]).sum(axis=1)
    heights = share @ np.array([HEEL_M, TOE_M, HEEL_M, TOE_M] if has_feet else [ANKLE_M] * 4)
    hips = (body[:, HIPS[0]] + body[:, HIPS[1]]) / 2
    stiffness = _build_depth_prior(steps)
    tangents = np.linalg.svd(before.upward[None])[2][1:]
    camera_height = before.camera_height
    expected = (
        np.average(heights - feet @ before.upward, weights=weight) if camera_height is None else camera_height
    )
    is_known = camera_height is not None
    precision = np.array(
        [before.tilt_std**-2] * 2 + [is_known / ((size_share * expected) ** 2 + before.height_std**2)]
    )
    start = np.array([0.0, 0.0, expected])
    border, shifts = start, np.zeros(len(known))
    remaining = np.eye(3)
    for _ in range(ITERATIONS):
        upward = before.upward + border[:2] @ tangents
        upward /= np.linalg.norm(upward)
        moved = feet + shifts[:, None] * hips
        error = border[2] + moved @ upward - heights
        robust = weight / (1 + (error / (2 * HEIGHT_STD_M)) ** 2)
        by_border = np.column_stack([moved @ tangents.T, np.ones(len(known))])
        by_shift = hips @ upward
        matrix = stiffness.copy()
        matrix[2] += robust * by_shift**2
        mixed = (robust * by_shift)[:, None] * by_border
        gradient = by_shift * robust * error + _multiply(stiffness, shifts)
        solved = solveh_banded(matrix, np.column_stack([mixed, gradient]))
        remaining = (robust[:, None] * by_border).T @ by_border + np.diag(precision) - mixed.T @ solved[:, :3]
        slope = by_border.T @ (robust * error) + precision * (border - start) - mixed.T @ solved[:, 3]
        change = np.linalg.solve(remaining, slope)
        shifts, border = shifts - solved[:, 3] + solved[:, :3] @ change, border - change
    height, covariance = float(border[2]), np.linalg.inv(remaining)
    is_possible = MIN_CAMERA_HEIGHT_M < height < 1 / MIN_CAMERA_HEIGHT_M * expected
    if camera_height is None and not is_possible:
        return None
    tilt_std = math.sqrt(float(np.trace(covariance[:2, :2])) / 2)
    every = np.zeros(len(joints))
    every[known] = shifts
    if camera_height is not None:
        size = camera_height / height if is_possible else math.inf
        return FloorFit(Floor(upward, camera_height, tilt_std, before.height_std), size, every)
    height_std = math.hypot(math.sqrt(float(covariance[2, 2])), size_share * height)
    return FloorFit(Floor(upward, height, tilt_std, height_std), 1.0, every)


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


def _multiply(bands: Array, values: Array) -> Array:
    """Return the product of a symmetric matrix, by its upper bands (3, F), and a vector."""
    product = bands[2] * values
    for offset in (1, 2):
        product[:-offset] += bands[2 - offset, offset:] * values[offset:]
        product[offset:] += bands[2 - offset, offset:] * values[:-offset]
    return np.asarray(product)
