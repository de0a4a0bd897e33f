# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the periodic model (TPAMI 2016, section 3.3): the terms of the body and a list of further ones.

    E = sum_tj w_tj rho(|s_t C_t[:2] Rz(psi_t) P_tj + t_t - x_tj|^2 / s0^2)    reprojection error (eq. 18)
      + beta   sum_tb (length_tb - mean_b)^2                                   bone lengths (eq. 20)
      + coefficient prior + movement of the camera + level cameras             a file each

The pose P_tj has the weights theta_t, and (theta_t, psi_t) = u(t) are the Fourier series of module `fourier` with
the coefficients c_pl. Base poses have no heading, but a body turns with every stride: psi is this turn, Rz a
rotation about the vertical of the body, and C_t the rotation of the camera, which does not contain the strides.
rho is Cauchy's loss, and the first two terms are those of the joint solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.camera_movement import CameraMovement
from mocap_ros.solvers.periodic.coefficient_prior import CoefficientPrior
from mocap_ros.solvers.periodic.fourier import FourierSeries
from mocap_ros.solvers.periodic.level_cameras import LevelCameras
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations, Step
from mocap_ros.solvers.periodic.point import Point, make_body_state
from mocap_ros.solvers.periodic.term import Term
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

# Properties of walks and runs.
MODEL_ERROR = 0.01  # m; error of a coordinate from what a periodic motion cannot explain, added to the image noise
STILL_CAMERA_FACTOR = 300.0  # on the weight of the camera's velocity if the camera is supposed to stand still
MIN_FREE_FRACTION = 0.05  # of the coordinates; guards the noise estimate against too many unknowns


@dataclass(frozen=True, eq=False)
class PeriodicObjective:
    """The objective E of one window of N frames, a `levenberg_marquardt.Problem` of one sequence.

    Attributes:
        body: reprojection and bone lengths, as in the joint solver.
        times: (N,) s.
        terms: all further terms.
    """

    body: JointObjective
    times: Array
    terms: tuple[Term, ...]

    @staticmethod
    def build(window: Window, unit: float, model: BasePoses, config: SolverConfig) -> PeriodicObjective:
        """Return the objective of a window; `unit` px/m converts image errors to metres."""
        body = JointObjective.build([window], np.array([unit]), model, config)
        velocity, acceleration = config.camera_velocity_weight, config.camera_acceleration_weight
        prior_weight = config.prior_weight * config.periodic_prior_factor
        terms: list[Term] = [
            CoefficientPrior.build(config.harmonics, model.std, prior_weight),
            CameraMovement.build(window.times, velocity, acceleration),
        ]
        if model.aligned_by_heading:
            terms.append(LevelCameras.build(len(window.times), config.prior_weight))
        return PeriodicObjective(replace(body, terms=(body.reprojection, body.bones)), window.times, tuple(terms))

    def with_noise(self, noise: float) -> PeriodicObjective:
        """Return the objective for this image noise (standard deviation, m), to which `MODEL_ERROR` is added."""
        return replace(self, body=self.body.with_noise(np.array([np.hypot(noise, MODEL_ERROR)])))

    def with_still_camera(self, config: SolverConfig) -> PeriodicObjective:
        """Return the objective for a camera that hardly moves."""
        velocity = STILL_CAMERA_FACTOR * config.camera_velocity_weight
        return self.with_term(CameraMovement.build(self.times, velocity, config.camera_acceleration_weight))

    def with_term(self, term: Term) -> PeriodicObjective:
        """Return the objective with a term in place of that of the same class."""
        return replace(self, terms=tuple(term if type(t) is type(term) else t for t in self.terms))

    def measure(self, series: FourierSeries, cameras: State) -> Point:
        """Return the point of a series and cameras, with each translation at its optimum.

        For a robust loss it is a step to the optimum from the translation of the cameras.
        """
        fit = self.body.with_optimal_translation(make_body_state(series, cameras, self.times))
        cameras = State(cameras.theta, cameras.rotation, cameras.log_scale, fit.state.translation)
        return Point(series, cameras, fit)

    def cost(self, point: Point) -> Array:
        """Return the value of the objective, (1,) m^2."""
        return self.body.cost(point.fit) + sum(term.cost(point) for term in self.terms)

    def normal_equations(
        self,
        point: Point,
        previous: PeriodicEquations | None = None,  # noqa: ARG002, part of the protocol
        is_done: NDArray[np.bool_] | None = None,  # noqa: ARG002, part of the protocol
    ) -> PeriodicEquations:
        """Return the equations of a Gauss-Newton step; there is no second sequence that could be done earlier."""
        equations = PeriodicEquations.begin(
            self.body.normal_equations(point.fit),
            point.cameras.rotation[:, :, 2],
            point.series.jacobian(self.times),
        )
        for term in self.terms:
            term.add_to(equations, point)
        return equations

    def step(self, equations: PeriodicEquations, damping: Array) -> Step | None:
        """Return the step under this damping (1,); None if the matrix is not positive definite."""
        return equations.solve_step(float(damping[0]))

    def advance(self, point: Point, step: Step) -> Point:
        """Return the point after a step, with the best translations."""
        return self.measure(point.series.with_step(step.series), point.cameras.advanced(step.cameras))

    def choose(self, is_chosen: NDArray[np.bool_], new: Point, old: Point) -> Point:
        """Return the new point if it is chosen (1,), else the old one."""
        return new if is_chosen[0] else old

    def estimate_noise(self, point: Point, effective_parameters: float) -> float:
        """Return the standard deviation (m) of a coordinate of a point of weight 1.

        The squared residuals are shared among the coordinates that the parameters leave free:

            noise^2 = sum of squared residuals / (number of coordinates - effective number of parameters)
        """
        reprojection = self.body.reprojection
        loss = float(reprojection.cost(point.fit).sum() * reprojection.variance_ratio[0])
        coordinates = 2 * int((reprojection.weight > 0).sum())
        free = max(coordinates - effective_parameters, MIN_FREE_FRACTION * coordinates + 1)
        return float(np.sqrt(loss / free))
