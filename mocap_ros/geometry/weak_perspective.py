# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Weak-perspective cameras: closed-form estimate and the camera step of Algorithm 1 (TPAMI 2016, section 3.2).

    x_tj = s_t R_t[:2] P_tj + t_t,   M_t = s_t R_t[:2]
    minimise over all M_t:  sum_tj w_tj |M_t P_tj - x_tj|^2 + sum_t gamma_t |M_t - M_(t-1)|^2      (eq. 12, 13)

P_tj is joint j in m, x_tj its image point, s_t the scale in image units per metre. The norms of the paper's eq. 13
are not squared. The best t_t brings the weighted centroids of image and projection together, so both are centred.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.camera_jacobian import camera_jacobian
from mocap_ros.geometry.rotations import nearest_rotation, rotation_from_vector

# 1, share of the body's second moments; keeps the closed form regular for poses that are nearly planar
RELATIVE_RIDGE = 1e-3
MIN_RIDGE = 1e-12  # m^2; keeps the closed form regular in frames without seen joints
MIN_SCALE = 1e-9  # image units per metre; guards divisions by the scale
MIN_TOTAL_WEIGHT = 1e-12  # 1; guards the division by the sum of weights in frames without seen joints
TIME_TOLERANCE_S = 1e-9  # s; includes frames that are exactly half a window away despite rounding
MIN_DIAGONAL = 1e-12  # squared image units; keeps the equations of a frame without seen joints regular
MAX_LOG_SCALE_STEP = 1  # 1; bounds the change of scale in one step to a factor of e
CAMERA_SWEEPS = 2  # passes over all frames in a camera step; the next iteration goes on from there
INITIAL_DAMPING = 1e-3  # 1, share of the diagonal; nearly a Gauss-Newton step, as the start is close
DAMPING_DECREASE = 3  # 1; damping is divided by it after an accepted step (usual Levenberg-Marquardt values)
DAMPING_INCREASE = 10  # 1; damping is multiplied by it after a rejected step


@dataclass(frozen=True, eq=False)
class WeakPerspectiveCameras:
    """Weak-perspective cameras of F frames, without their translation."""

    scale: Array  # (F,) units of the image points per metre
    # (F, 3, 3) rotation from the body frame, in which the poses are given, to the camera's optical frame (x right,
    # y down, z forward)
    rotation: Array

    @property
    def matrix(self) -> Array:
        """Return the (F, 2, 3) left part of the paper's camera matrix M (eq. 14)."""
        return np.asarray(self.scale[:, None, None] * self.rotation[:, :2])

    def project(self, poses: Array) -> Array:
        """Project poses (F, J, 3) to image points (F, J, 2) without translation."""
        return poses @ np.swapaxes(self.matrix, -1, -2)

    def where(self, mask: NDArray[np.bool_], alternative: WeakPerspectiveCameras) -> WeakPerspectiveCameras:
        """Return these cameras in the frames where `mask` (F,) is true, and `alternative` in the others."""
        return WeakPerspectiveCameras(
            np.where(mask, self.scale, alternative.scale),
            np.where(mask[:, None, None], self.rotation, alternative.rotation),
        )


def subtract_weighted_centroid(points: Array, weight: Array) -> tuple[Array, Array]:
    """Return points (..., J, D) relative to their centroids under weights (..., J), and the centroids (..., D)."""
    total = np.maximum(weight.sum(axis=-1), MIN_TOTAL_WEIGHT)[..., None]
    centroid = (weight[..., None] * points).sum(axis=-2) / total
    return points - centroid[..., None, :], centroid


def fit_cameras_closed_form(
    poses: Array, image: Array, weight: Array, times: Array, window: float
) -> WeakPerspectiveCameras:
    """M = argmin sum_j w_j |M P_j - x_j|^2, s = sqrt((|m1|^2 + |m2|^2) / 2), R from the SVD of M (eq. 10 and 11).

    Frames at most half of `window` s away share the problem, which is stable for bodies seen from the front and
    for missing points; the paper solves each frame alone (0). Eq. 11 as printed gives 0.707 of this scale. Poses
    (F, J, 3) in m, image (F, J, 2) finite and ignored where the weight is 0.
    """
    body, _ = subtract_weighted_centroid(poses, weight)
    seen, _ = subtract_weighted_centroid(image, weight)
    weighted = np.swapaxes(body * weight[..., None], -1, -2)
    moments = _sum_over_window(weighted @ body, times, window)
    cross = _sum_over_window(weighted @ seen, times, window)
    ridge = RELATIVE_RIDGE * np.trace(moments, axis1=-2, axis2=-1) + MIN_RIDGE
    affine = np.swapaxes(np.linalg.solve(moments + ridge[:, None, None] * np.eye(3), cross), -1, -2)
    scale = np.sqrt((affine**2).sum(axis=(-2, -1)) / 2)
    return WeakPerspectiveCameras(np.maximum(scale, MIN_SCALE), nearest_rotation(affine))


def _sum_over_window(values: Array, times: Array, window: float) -> Array:
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    first = np.searchsorted(times, times - window / 2 - TIME_TOLERANCE_S)
    last = np.searchsorted(times, times + window / 2 + TIME_TOLERANCE_S, side='right')
    return np.asarray(total[last] - total[first])


@dataclass(frozen=True, eq=False)
class CameraStepObjective:
    """Objective of the camera step of Algorithm 1: the cameras of all frames with the poses held (eq. 12, 13)."""

    body: Array  # (F, J, 3) poses in m, relative to the weighted centroid of the seen joints
    image: Array  # (F, J, 2) image points, relative to their weighted centroid
    weight: Array  # (F, J) weights of the squared reprojection errors
    flip_weight: Array  # (F - 1,) weights gamma of the squared changes of M between neighbouring frames

    def data_cost(self, cameras: WeakPerspectiveCameras) -> Array:
        """Return the weighted sums (F,) of squared reprojection errors."""
        error = cameras.project(self.body) - self.image
        return np.asarray((self.weight[..., None] * error**2).sum(axis=(-2, -1)))

    def flip_cost(self, cameras: WeakPerspectiveCameras) -> Array:
        """Return the weighted squared changes (F - 1,) of M between neighbouring frames (eq. 12)."""
        change = np.diff(cameras.matrix, axis=0)
        return np.asarray(self.flip_weight * (change**2).sum(axis=(-2, -1)))

    def local_cost(self, cameras: WeakPerspectiveCameras) -> Array:
        """Return the sums (F,) of all terms that depend on the own camera of a frame."""
        cost = self.data_cost(cameras)
        flip = self.flip_cost(cameras)
        cost[1:] += flip
        cost[:-1] += flip
        return cost

    def gauss_newton_step(self, cameras: WeakPerspectiveCameras, damping: Array) -> WeakPerspectiveCameras:
        """Move every frame's camera towards the minimum of its local cost, with its neighbours held.

        The diagonal of the equations in rotation vector and log scale grows by the share `damping` (F,).
        """
        turned = cameras.scale[:, None, None] * (self.body @ np.swapaxes(cameras.rotation, -1, -2))
        jacobian = camera_jacobian(turned, rows=2)
        error = turned[..., :2] - self.image
        w = self.weight[..., None, None]
        normal = (np.swapaxes(jacobian, -1, -2) @ (w * jacobian)).sum(axis=1)
        gradient = (np.swapaxes(jacobian, -1, -2) @ (w * error[..., None])).sum(axis=1)[..., 0]

        columns = np.swapaxes(cameras.scale[:, None, None] * cameras.rotation, -1, -2)
        m_jacobian = camera_jacobian(columns, rows=2)
        m_normal = (np.swapaxes(m_jacobian, -1, -2) @ m_jacobian).sum(axis=1)
        change = np.diff(columns[..., :2], axis=0)
        pull = np.zeros_like(columns[..., :2])
        pull[1:] += self.flip_weight[:, None, None] * change
        pull[:-1] -= self.flip_weight[:, None, None] * change
        stiffness = np.zeros(len(columns))
        stiffness[1:] += self.flip_weight
        stiffness[:-1] += self.flip_weight
        normal += stiffness[:, None, None] * m_normal
        gradient += (np.swapaxes(m_jacobian, -1, -2) @ pull[..., None]).sum(axis=1)[..., 0]

        diagonal = np.einsum('fii->fi', normal)
        diagonal *= 1 + damping[:, None]
        diagonal += MIN_DIAGONAL
        step = -np.linalg.solve(normal, gradient[..., None])[..., 0]
        return WeakPerspectiveCameras(
            cameras.scale * np.exp(np.clip(step[:, 3], -MAX_LOG_SCALE_STEP, MAX_LOG_SCALE_STEP)),
            rotation_from_vector(step[:, :3]) @ cameras.rotation,
        )


def run_camera_step(objective: CameraStepObjective, cameras: WeakPerspectiveCameras) -> WeakPerspectiveCameras:
    """Improve the cameras of all frames with the poses held (eq. 13).

    All even frames move at once, then all odd ones: block-coordinate descent as in the paper, without its loop
    over frames. A frame's step is accepted only if it does not raise the objective.
    """
    frames = len(cameras.scale)
    damping = np.full(frames, INITIAL_DAMPING)
    for _ in range(CAMERA_SWEEPS):
        for parity in (0, 1):
            moving = np.arange(frames) % 2 == parity
            candidate = objective.gauss_newton_step(cameras, damping).where(moving, cameras)
            accepted = objective.local_cost(candidate) <= objective.local_cost(cameras)
            cameras = candidate.where(moving & accepted, cameras)
            adapted = np.where(accepted, damping / DAMPING_DECREASE, damping * DAMPING_INCREASE)
            damping = np.where(moving, adapted, damping)
    return cameras
