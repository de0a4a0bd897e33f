# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Velocity and acceleration of the camera are small (beyond TPAMI 2016, which weighs its changes, eq. 12).

    gamma int |dM / dt|^2 dt + kappa int |d^2 M / dt^2|^2 dt,    M_t = s_t C_t[:2]

With differences instead of derivatives this is a quadratic form of the M_t (`make_camera_bands`):

    sum_tu Q_tu <M_t, M_u>,    Q_tu = 0 for |t - u| > 2

With m_t = vec(M_t) and z_t the 4 unknowns of a camera (rotation vector, log scale), the Gauss-Newton matrix has
the blocks (dm_t / dz_t)^T Q_tu (dm_u / dz_u), and half the gradient is (dm_t / dz_t)^T sum_u Q_tu m_u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, fill_camera_jacobian
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.point import Point

Array = NDArray[np.float64]

MIN_TIME_STEP_S = 1e-4  # s; guards divisions by the time step; far below the period of any camera


@dataclass(frozen=True, eq=False)
class CameraMovement:
    """The term of the periodic objective.

    Attributes:
        bands: (3, N) main diagonal and the two below it of the symmetric matrix Q: bands[d, u] = Q_(u+d)u.
    """

    bands: Array

    @staticmethod
    def build(times: Array, velocity_weight: float, acceleration_weight: float) -> CameraMovement:
        """Return the term of these times (N,) s and the weights gamma (m^2 s) and kappa (m^2 s^3)."""
        return CameraMovement(make_camera_bands(times, velocity_weight, acceleration_weight))

    def cost(self, point: Point) -> float:
        """Return the value of the term, m^2."""
        matrices = camera_matrices(point.cameras)
        return float((matrices * self.half_gradient(matrices)).sum())

    def add_to(self, equations: PeriodicEquations, point: Point) -> None:
        """Add the blocks of the matrix and the gradient, in place."""
        cameras = point.cameras
        frames = len(cameras.rotation)
        columns = np.swapaxes(np.exp(cameras.log_scale)[:, None, None] * cameras.rotation, -1, -2)
        by_axis = np.empty((frames, 2, 3, CAMERA_UNKNOWNS))
        fill_camera_jacobian(np.swapaxes(by_axis, 1, 2), columns)
        jacobian = by_axis.reshape(frames, 6, CAMERA_UNKNOWNS)
        transposed = np.swapaxes(jacobian, -1, -2)
        for below, blocks in enumerate((equations.camera_prior, *equations.camera_coupling.corner)):
            end = max(frames - below, 0)
            blocks[:end] += self.bands[below, :end, None, None] * (transposed[below:] @ jacobian[:end])
        force = self.half_gradient(np.swapaxes(columns[:, :, :2], -1, -2)).reshape(frames, 6, 1)
        equations.camera_gradient[:] += (transposed @ force)[..., 0]

    def half_gradient(self, matrices: Array) -> Array:
        """Return sum_u Q_tu M_u (N, 2, 3), half the gradient by the matrices M_t (N, 2, 3)."""
        bands = self.bands[..., None, None]
        out = bands[0] * matrices
        for below in (1, 2):
            band = bands[below, :-below]
            out[below:] += band * matrices[:-below]
            out[:-below] += band * matrices[below:]
        return np.asarray(out)


def camera_matrices(cameras: State) -> Array:
    """Return the matrices M_t = s_t C_t[:2], (N, 2, 3)."""
    return np.asarray(np.exp(cameras.log_scale)[:, None, None] * cameras.rotation[:, :2])


def make_camera_bands(times: Array, velocity_weight: float, acceleration_weight: float) -> Array:
    """Return the bands of Q, the quadratic form of velocity and acceleration at irregular times.

        sum_tu Q_tu m_t m_u = gamma sum_t d_t^2 dt_t + kappa sum_t (d_(t+1) - d_t)^2 / h_t
        d_t = (m_(t+1) - m_t) / dt_t,    dt_t = times_(t+1) - times_t,    h_t = (dt_t + dt_(t+1)) / 2

    Args:
        times: (N,) s.
        velocity_weight: gamma, m^2 s.
        acceleration_weight: kappa, m^2 s^3.

    Returns:
        (3, N), row d the d-th diagonal of Q below the main one: bands[d, u] = Q_(u+d)u.
    """
    bands = np.zeros((3, len(times)))
    dt = np.maximum(np.diff(times), MIN_TIME_STEP_S)
    velocity = np.stack([-1 / dt, 1 / dt], axis=-1)
    velocity_change = np.stack([1 / dt[:-1], -1 / dt[:-1] - 1 / dt[1:], 1 / dt[1:]], axis=-1)
    for stencil, weight in (
        (velocity, velocity_weight * dt),
        (velocity_change, 2 * acceleration_weight / (dt[:-1] + dt[1:])),
    ):
        for i in range(stencil.shape[1]):
            for j in range(i + 1):
                bands[i - j, j : j + len(stencil)] += weight * stencil[:, i] * stencil[:, j]
    return bands
