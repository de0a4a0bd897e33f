"""The objective of the periodic model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import small_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.objective import Problem
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.fourier import Series, shares
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]


# what walks and runs are like; rad and m
CONSTANT_STD = 0.008


HEADING_STD = 0.25


MODEL_ERROR = 0.01


LEVEL_STD = 0.17


NO_CONSTANT_HEADING = 1e-3  # which would be the camera's


STILL = 300.0


LEAST_FREE = 0.05


SHORTEST_STEP = 1e-4


def about_vertical(angle: Array) -> Array:
    """(N,) rad -> (N, 3, 3) turns of the body."""
    return small_rotation(np.stack([0 * angle, 0 * angle, angle], axis=-1))


@dataclass(frozen=True, eq=False)
class Objective:
    """What a series and cameras are judged by.

    Attributes:
        problem: reprojection and bone lengths.
        times: (N,) s.
        prior: (P, K + 1) weight of each coefficient squared.
        level: weight of the squared tilt of each frame's camera.
        roughness: (3, N) bands, the diagonal and two below, of the quadratic form of an entry of M over time.
    """

    problem: Problem
    times: Array
    prior: Array
    roughness: Array
    level: float

    @staticmethod
    def build(window: Window, unit: float, model: BasePoses, config: SolverConfig) -> Objective:
        """The objective of one window, errors in metres by `unit` px/m."""
        bare = replace(
            config, smooth_weight=0.0, prior_weight=0.0, flip_weight=0.0, tilt_weight=0.0, scale_weight=0.0
        )
        problem = Problem.build([window], np.array([unit]), model, bare)
        sines = config.paper_sines
        share = shares(2 if sines else 2 * config.harmonics + 1, sines)[:, None]
        variance = share * np.append(model.std, HEADING_STD) ** 2
        if not sines:
            variance[0] = 1 / (1 / variance[0] + 1 / CONSTANT_STD**2)
            variance[0, -1] = NO_CONSTANT_HEADING**2
        level = config.prior_weight / LEVEL_STD**2 if model.upright else 0.0
        return Objective(
            problem,
            window.times,
            config.prior_weight * config.periodic_prior_factor / variance,
            roughness(window.times, config.camera_velocity_weight, config.camera_acceleration_weight),
            level / len(window.times),
        )

    def under_noise(self, noise: float) -> Objective:
        """The same objective under image noise of this standard deviation (m) and the model's own error."""
        return replace(self, problem=self.problem.under_noise(np.array([np.hypot(noise, MODEL_ERROR)])))

    def of_still_camera(self, config: SolverConfig) -> Objective:
        """The same objective for a camera that hardly moves."""
        return replace(
            self,
            roughness=roughness(
                self.times, STILL * config.camera_velocity_weight, config.camera_acceleration_weight
            ),
        )

    def body(self, series: Series, cameras: State) -> State:
        """Weights and rotations of the bodies; the `cameras` hold the rest, their theta is not looked at."""
        values = series.values(self.times)
        return replace(cameras, theta=values[:, :-1], rotation=cameras.rotation @ about_vertical(values[:, -1]))

    def best_translation(self, series: Series, cameras: State) -> State:
        """The cameras with each translation at its optimum (a step of the robust fit)."""
        return replace(cameras, translation=self.problem.settled(self.body(series, cameras)).state.translation)

    def cost(self, series: Series, cameras: State) -> float:
        """Value of the objective, m^2."""
        matrix = np.exp(cameras.log_scale)[:, None, None] * cameras.rotation[:, :2]
        return float(
            self.problem.cost(self.problem.fit(self.body(series, cameras)))[0]
            + (self.prior * series.coefficients**2).sum()
            + (matrix * self.pull(matrix)).sum()
            + self.level * (cameras.rotation[:, ::2, 2] ** 2).sum()
        )

    def pull(self, matrix: Array) -> Array:
        """(N, 2, 3) half the gradient of the cameras' terms by M."""
        bands = self.roughness[..., None, None]
        out = bands[0] * matrix
        for below in (1, 2):
            band = bands[below, :-below]
            out[below:] += band * matrix[:-below]
            out[:-below] += band * matrix[below:]
        return np.asarray(out)

    def noise(self, series: Series, cameras: State, absorbed: float) -> float:
        """m, standard deviation of a coordinate from the residual, less what the unknowns have absorbed."""
        image = replace(self.problem, bone_weight=np.zeros_like(self.problem.bone_weight))
        loss = float(image.cost(image.fit(self.body(series, cameras)))[0] * self.problem.level[0])
        coordinates = 2 * int((self.problem.weight > 0).sum())
        return float(np.sqrt(loss / max(coordinates - absorbed, LEAST_FREE * coordinates + 1)))


def roughness(times: Array, drift: float, steady: float) -> Array:
    """(3, N) bands of `drift` times the integral of the squared first, `steady` times the second derivative."""
    bands = np.zeros((3, len(times)))
    dt = np.maximum(np.diff(times), SHORTEST_STEP)
    slope = np.stack([-1 / dt, 1 / dt], axis=-1)
    bend = np.stack([1 / dt[:-1], -1 / dt[:-1] - 1 / dt[1:], 1 / dt[1:]], axis=-1)
    for stencil, weight in ((slope, drift * dt), (bend, 2 * steady / (dt[:-1] + dt[1:]))):
        for i in range(stencil.shape[1]):
            for j in range(i + 1):
                bands[i - j, j : j + len(stencil)] += weight * stencil[:, i] * stencil[:, j]
    return bands
