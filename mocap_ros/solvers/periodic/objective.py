# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the periodic model (TPAMI 2016, section 3.3).

    E = sum_tj w_tj rho(|s_t C_t[:2] Rz(psi_t) P_tj + t_t - x_tj|^2 / s0^2)    reprojection error (eq. 18)
      + beta   sum_tb (length_tb - mean_b)^2                                   bone lengths (eq. 20)
      + lambda sum_pl c_pl^2 / var_pl                                          prior of the coefficients
      + gamma  int |dM / dt|^2 dt + kappa int |d^2 M / dt^2|^2 dt              movement of the camera, M = s C[:2]
      + nu     mean_t |tilt_t|^2                                               level cameras

P_tj has the weights theta_t; (theta_t, psi_t) = u(t) are Fourier series (`fourier`), psi the turn of the body with
every stride, Rz a rotation about its vertical, C_t the camera without the strides, rho Cauchy's loss. The prior
counts once a window: the variance of a weight is shared among the terms of its series (`fourier.variance_shares`),
with less for constants. The tilt is x and z of C_t e_z, for base poses aligned by heading. The paper weighs
changes of the camera (eq. 12) and has neither prior nor tilt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint as engine
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, fill_camera_jacobian
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.joint.differences import (
    FiniteDifference,
    invert_time_steps,
    weigh_velocity_change,
)
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.periodic.fourier import FourierSeries, variance_shares
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations, Step
from mocap_ros.solvers.window import Window

# Properties of walks and runs.
MODEL_ERROR = 0.01  # m; error of a coordinate from what a periodic motion cannot explain, added to the image noise
STILL_CAMERA_FACTOR = 300.0  # on the weight of the camera's velocity if the camera is supposed to stand still
CONSTANT_STD = 0.008  # m; of the constant coefficients: a person's mean pose is near that of the model
HEADING_STD = 0.25  # rad; of the heading: the body turns by 7 degrees RMS in CMU walks, by 15 in runs
CONSTANT_HEADING_STD = 1e-3  # rad; of the constant of the heading: the rotation of the camera already contains it
LEVEL_STD = 0.17  # rad; of the tilt of the camera: 10 degrees, a weak prior
MAX_LOG_SCALE_STEP = 1.0  # of one step; a larger one is a failed linearisation
MIN_FREE_FRACTION = 0.05  # of the coordinates; guards the noise estimate against too many unknowns


@dataclass(frozen=True, eq=False)
class Point:
    """Values of the unknowns of a window of N frames."""

    series: FourierSeries  # Fourier series of the weights and the heading
    cameras: State  # cameras C_t without the heading, with no weights: theta is (N, 0)
    body: State  # weights theta_t and rotations C_t Rz(psi_t) with the translations of the cameras
    cost: float  # m^2, value of the objective


@dataclass(eq=False)
class PeriodicObjective:
    """The objective E of one window of N frames."""

    body: JointObjective  # reprojection and bone lengths, as in the joint solver
    problem: engine.JointProblem  # the same, compiled; objectives `with_still_camera` share it
    prior: Array  # (P, K + 1) lambda / var_pl, the factor on the square of each coefficient
    movement: Array  # (R, N) rows whose products with the elements (N, 6) of M are its movement
    level_weight: float  # nu / N, m^2

    @staticmethod
    def build(window: Window, unit: float, model: BasePoses, config: SolverConfig) -> PeriodicObjective:
        """Return the objective of a window; `unit` px/m converts image errors to metres."""
        batch = Batch.build([window], np.array([unit]), model)
        body = replace(JointObjective.build(batch, model, config), prior=np.zeros(len(model.std)), differences=())
        variance = variance_shares(config.harmonics)[:, None] * np.append(model.std, HEADING_STD) ** 2
        variance[0] = 1 / (1 / variance[0] + 1 / CONSTANT_STD**2)
        variance[0, -1] = CONSTANT_HEADING_STD**2
        level_weight = config.prior_weight / LEVEL_STD**2 / len(window.times) if model.aligned_by_heading else 0.0
        return PeriodicObjective(
            body,
            body.compile(),
            config.prior_weight * config.periodic_prior_factor / variance,
            weigh_movement(batch, config.camera_velocity_weight, config.camera_acceleration_weight),
            level_weight,
        )

    def set_noise(self, noise: float) -> None:
        """Set the image noise (standard deviation, m), to which `MODEL_ERROR` is added.

        It is that of all objectives that share the compiled problem.
        """
        self.body = self.body.with_noise(np.array([np.hypot(noise, MODEL_ERROR)]))
        self.problem.weigh(self.body.noise_ratio, self.body.factors)

    def with_still_camera(self, config: SolverConfig) -> PeriodicObjective:
        """Return the objective for a camera that hardly moves."""
        velocity = STILL_CAMERA_FACTOR * config.camera_velocity_weight
        movement = weigh_movement(self.body.batch, velocity, config.camera_acceleration_weight)
        return replace(self, movement=movement)

    def measure(self, series: FourierSeries, cameras: State, settle_steps: int = 1) -> Point:
        """Return the point of a series and cameras.

        `settle_steps` number of steps of the robust fit by which each translation moves to its optimum.
        """
        values = series.evaluate(self.body.batch.times)
        rotation = cameras.rotation @ rotations_about_vertical(values[:, -1])
        body = State(values[:, :-1], rotation, cameras.log_scale, cameras.translation)
        self.problem.start(*body, settle_steps)
        moved, tilt = self.movement @ measure_matrices(cameras), cameras.rotation[:, ::2, 2].ravel()
        prior = self.prior.ravel() @ series.coefficients.ravel() ** 2
        cost = float(self.problem.cost[0] + prior + np.vdot(moved, moved) + self.level_weight * (tilt @ tilt))
        translation = self.problem.read('translation')
        cameras, body = cameras._replace(translation=translation), body._replace(translation=translation)
        return Point(series, cameras, body, cost)

    def normal_equations(self, point: Point) -> PeriodicEquations:
        """Return the equations of a Gauss-Newton step."""
        cameras = point.cameras
        self.problem.start(*point.body)
        self.problem.begin(0.0)
        vertical = cameras.rotation[:, :, 2]
        equations = PeriodicEquations.begin(
            self.problem, vertical, *point.series.differentiate(self.body.batch.times)
        )
        size = self.prior.size
        equations.series_prior[:size] += self.prior.ravel()
        equations.series_gradient[:size] += (self.prior * point.series.coefficients).ravel()
        blocks, gradient = equations.camera_prior, equations.camera_gradient
        jacobian, moved = differentiate_matrices(cameras), self.movement @ measure_matrices(cameras)
        squares = self.movement.T @ self.movement
        transposed = np.swapaxes(jacobian, 1, 2)
        gradient += (transposed @ (self.movement.T @ moved)[..., None])[..., 0]
        for d, target in enumerate((blocks, *np.swapaxes(equations.camera_coupling, 0, 1))):
            count = max(len(blocks) - d, 0)
            target[:count] += squares.diagonal(d)[:, None, None] * (transposed[d:] @ jacobian[:count])
        x, y, z = vertical.T
        across, along = np.stack([0 * x, z, -y], axis=1), np.stack([y, -x, 0 * x], axis=1)  # d x / d w, d z / d w
        blocks[:, :3, :3] += self.level_weight * (
            across[:, :, None] * across[:, None] + along[:, :, None] * along[:, None]
        )
        gradient[:, :3] += self.level_weight * (x[:, None] * across + z[:, None] * along)
        return equations

    def advance(self, point: Point, step: Step) -> Point:
        """Return the point after a step, with the best translations."""
        return self.measure(point.series.with_step(step.series), move_cameras(point.cameras, step.cameras))

    def estimate_noise(self, point: Point, effective_parameters: float) -> float:
        """Return the standard deviation (m) of a coordinate of a point of weight 1.

        The squared residuals are shared among the coordinates that the parameters leave free:

            noise^2 = sum of squared residuals / (number of coordinates - effective number of parameters)
        """
        self.problem.start(*point.body)
        squared, score = self.problem.read('squared'), self.body.batch.score
        c = self.body.robust_scale * max(float(self.body.noise_ratio[0]), 1.0)
        loss = float((score * (squared if np.isinf(c) else c**2 * np.log1p(squared / c**2))).sum())
        coordinates = 2 * int((score > 0).sum())
        free = max(coordinates - effective_parameters, MIN_FREE_FRACTION * coordinates + 1)
        return float(np.sqrt(loss / free))


def weigh_movement(batch: Batch, velocity_weight: float, acceleration_weight: float) -> Array:
    """Return the rows of velocity and acceleration with the weights gamma (m^2 s) and kappa (m^2 s^3)."""
    root = np.sqrt(velocity_weight * invert_time_steps(batch))
    change = np.sqrt(acceleration_weight) * weigh_velocity_change(batch)
    every = np.ones(6)
    terms = FiniteDifference(np.stack([-root, root], axis=1), every), FiniteDifference(change, every)
    return np.concatenate([term.rows for term in terms])


def measure_matrices(cameras: State) -> Array:
    """Return the elements (N, 6) of the matrices M_t = s_t C_t[:2]."""
    return np.asarray(np.exp(cameras.log_scale)[:, None] * cameras.rotation[:, :2].reshape(-1, 6))


def differentiate_matrices(cameras: State) -> Array:
    """Return the derivatives (N, 6, 4) of the elements of M by the rotation vector and the log scale."""
    columns = np.swapaxes(np.exp(cameras.log_scale)[:, None, None] * cameras.rotation, -1, -2)
    by_axis = np.empty((len(columns), 2, 3, CAMERA_UNKNOWNS))
    fill_camera_jacobian(np.swapaxes(by_axis, 1, 2), columns)
    return by_axis.reshape(len(columns), 6, CAMERA_UNKNOWNS)


def move_cameras(cameras: State, step: Array) -> State:
    """Return cameras after a step (N, 4): rotation vectors and changes of the log scale."""
    change = np.clip(step[:, 3], -MAX_LOG_SCALE_STEP, MAX_LOG_SCALE_STEP)
    rotation = rotation_from_vector(step[:, :3]) @ cameras.rotation
    return cameras._replace(rotation=rotation, log_scale=cameras.log_scale + change)


def rotations_about_vertical(angle: Array) -> Array:
    """Return the rotations (N, 3, 3) of the body about its vertical axis (z) by angles (N,) in rad."""
    out = np.zeros((len(angle), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(angle)
    out[:, 1, 0] = np.sin(angle)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out
