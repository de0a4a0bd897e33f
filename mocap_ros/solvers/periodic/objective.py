"""The objective of the periodic model (TPAMI 2016, section 3.3).

    E = sum_tj w_tj rho(|s_t C_t[:2] Rz(psi_t) P_tj + t_t - x_tj|^2 / s0^2)    reprojection error (eq. 18)
      + beta   sum_tb (length_tb - mean_b)^2                                   bone lengths (eq. 20)
      + lambda sum_pl c_pl^2 / var_pl                                          Gaussian prior of the coefficients
      + gamma  int |dM / dt|^2 dt                                              velocity of the camera
      + kappa  int |d^2 M / dt^2|^2 dt                                         acceleration of the camera
      + nu     mean_t |tilt_t|^2                                               level cameras

The pose P_tj has the weights theta_t, and (theta_t, psi_t) = u(t) are the Fourier series of module `fourier` with
the coefficients c_pl. Base poses have no heading, but a body turns with every stride: psi is this turn, Rz a
rotation about the vertical of the body, and C_t the rotation of the camera, which does not contain the strides.
M_t = s_t C_t[:2], and tilt_t are the x and z components of the vertical C_t e_z in the camera frame; this term is
for models whose base poses were aligned by heading. The prior occurs once a window, not once a frame, since the
coefficients do. rho is Cauchy's loss, and the first two terms are those of the joint solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.fourier import FourierSeries, variance_shares
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

# Properties of walks and runs.
CONSTANT_STD = 0.008  # m; of the constant coefficients: a person's mean pose is near that of the model
HEADING_STD = 0.25  # rad; of the heading: the body turns by 7 degrees RMS in CMU walks, by 15 in runs
MODEL_ERROR = 0.01  # m; error of a coordinate from what a periodic motion cannot explain, added to the image noise
LEVEL_STD = 0.17  # rad; of the tilt of the camera: 10 degrees, a weak prior

CONSTANT_HEADING_STD = 1e-3  # rad; of the constant of the heading: the rotation of the camera already contains it
STILL_CAMERA_FACTOR = 300.0  # on the weight of the camera's velocity if the camera is supposed to stand still
MIN_FREE_FRACTION = 0.05  # of the coordinates; guards the noise estimate against too many unknowns
MIN_TIME_STEP_S = 1e-4  # s; guards divisions by the time step; far below the period of any camera


def rotations_about_vertical(angle: Array) -> Array:
    """Return the rotations (N, 3, 3) of the body about its vertical axis (z) by angles (N,) in rad."""
    return rotation_from_vector(np.stack([0 * angle, 0 * angle, angle], axis=-1))


@dataclass(frozen=True, eq=False)
class PeriodicObjective:
    """Constants of the objective E of one window of N frames.

    Attributes:
        problem: reprojection and bone-length terms, as in the joint solver.
        times: (N,) s.
        prior: (P, K + 1) weights lambda / var_pl of the squared coefficients.
        camera_bands: (3, N) main diagonal and the two below it of the symmetric matrix Q of the camera terms,
            which are sum_tu Q_tu <M_t, M_u>.
        level_weight: nu / N, weight of the squared tilt of a frame.
    """

    problem: JointObjective
    times: Array
    prior: Array
    camera_bands: Array
    level_weight: float

    @staticmethod
    def build(window: Window, unit: float, model: BasePoses, config: SolverConfig) -> PeriodicObjective:
        """Return the objective of a window; `unit` px/m converts image errors to metres."""
        data_terms = replace(
            config, smooth_weight=0.0, prior_weight=0.0, flip_weight=0.0, tilt_weight=0.0, scale_weight=0.0
        )
        problem = JointObjective.build([window], np.array([unit]), model, data_terms)
        variance = variance_shares(config.harmonics)[:, None] * np.append(model.std, HEADING_STD) ** 2
        variance[0] = 1 / (1 / variance[0] + 1 / CONSTANT_STD**2)
        variance[0, -1] = CONSTANT_HEADING_STD**2
        level_weight = config.prior_weight / LEVEL_STD**2 if model.aligned_by_heading else 0.0
        return PeriodicObjective(
            problem,
            window.times,
            config.prior_weight * config.periodic_prior_factor / variance,
            make_camera_bands(window.times, config.camera_velocity_weight, config.camera_acceleration_weight),
            level_weight / len(window.times),
        )

    def with_noise(self, noise: float) -> PeriodicObjective:
        """Return the objective for this image noise (standard deviation, m), to which `MODEL_ERROR` is added."""
        return replace(self, problem=self.problem.with_noise(np.array([np.hypot(noise, MODEL_ERROR)])))

    def with_still_camera(self, config: SolverConfig) -> PeriodicObjective:
        """Return the objective for a camera that hardly moves."""
        return replace(
            self,
            camera_bands=make_camera_bands(
                self.times,
                STILL_CAMERA_FACTOR * config.camera_velocity_weight,
                config.camera_acceleration_weight,
            ),
        )

    def body_state(self, series: FourierSeries, cameras: State) -> State:
        """Return the state with weights theta_t and rotations C_t Rz(psi_t); the theta of `cameras` is ignored."""
        values = series.evaluate(self.times)
        return replace(
            cameras,
            theta=values[:, :-1],
            rotation=cameras.rotation @ rotations_about_vertical(values[:, -1]),
        )

    def with_optimal_translation(self, series: FourierSeries, cameras: State) -> State:
        """Return the cameras with each translation at its optimum (for a robust loss, after one step to it)."""
        return replace(
            cameras,
            translation=self.problem.with_optimal_translation(self.body_state(series, cameras)).state.translation,
        )

    def cost(self, series: FourierSeries, cameras: State) -> float:
        """Return the value of the objective, m^2."""
        matrix = np.exp(cameras.log_scale)[:, None, None] * cameras.rotation[:, :2]
        return float(
            self.problem.cost(self.problem.fit(self.body_state(series, cameras)))[0]
            + (self.prior * series.coefficients**2).sum()
            + (matrix * self.camera_half_gradient(matrix)).sum()
            + self.level_weight * (cameras.rotation[:, ::2, 2] ** 2).sum()
        )

    def camera_half_gradient(self, matrix: Array) -> Array:
        """Return sum_u Q_tu M_u (N, 2, 3), half the gradient of velocity and acceleration terms by M (N, 2, 3)."""
        bands = self.camera_bands[..., None, None]
        out = bands[0] * matrix
        for below in (1, 2):
            band = bands[below, :-below]
            out[below:] += band * matrix[:-below]
            out[:-below] += band * matrix[below:]
        return np.asarray(out)

    def estimate_noise(self, series: FourierSeries, cameras: State, effective_parameters: float) -> float:
        """Return the standard deviation (m) of a coordinate of a point of weight 1.

        The squared residuals are shared among the coordinates that the parameters leave free:

            noise^2 = sum of squared residuals / (number of coordinates - effective number of parameters)
        """
        reprojection = self.problem.reprojection
        fit = self.problem.fit(self.body_state(series, cameras))
        loss = float(reprojection.cost(fit).sum() * reprojection.variance_ratio[0])
        coordinates = 2 * int((reprojection.weight > 0).sum())
        free = max(coordinates - effective_parameters, MIN_FREE_FRACTION * coordinates + 1)
        return float(np.sqrt(loss / free))


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
