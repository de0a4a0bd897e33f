# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The solver of the periodic model: Levenberg-Marquardt over Fourier series and cameras.

It minimises the objective E of module `periodic.objective` over the coefficients of the series, their frequency
omega and the cameras, as follows.

1. Initial values: the weights theta of poses found without periodicity; a series fitted to them, its cadence
   from a scan (`fourier.fit_initial_series`).
2. Hypotheses, if the noise is large: a second cadence, and a camera that hardly moves. E is minimised from each,
   and the one with the highest evidence is kept, the cameras integrated over by Laplace's method:

       -2 log p(x | hypothesis) = min E / (10 mm)^2 + log det C - log det C_prior + constant

   with C the normal matrix of the cameras and C_prior the part of it that does not come from the image.
3. Image noise: the noise is estimated from the residual and E is minimised under it, in alternation.
4. E is minimised under the final noise. Every step eliminates the cameras, 4 unknowns a frame, which leaves a
   dense system of (2 H + 1) (K + 1) + 1 unknowns (module `periodic.normal_equations`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE
from mocap_ros.solvers.joint.solver import WARM_DAMPING, make_reconstruction
from mocap_ros.solvers.levenberg_marquardt import (
    DAMPING_AFTER_FAILURE,
    DAMPING_AFTER_SUCCESS,
    MAX_DAMPING,
    MIN_DAMPING,
    Stepwise,
    ignore_overflow,
    minimise_stepwise,
    run_to_end,
)
from mocap_ros.solvers.periodic.fourier import FourierSeries, fit_initial_series
from mocap_ros.solvers.periodic.normal_equations import PeriodicEquations
from mocap_ros.solvers.periodic.objective import PeriodicObjective, Point, rotations_about_vertical
from mocap_ros.solvers.window import InitialValues, Reconstruction, SolverStatus, Window

MAX_INITIAL_ITERATIONS = 12  # steps of the joint solver for initial values; a coarse result is sufficient
NOISE_ROUNDS = 2  # estimates of the image noise, each after a minimisation under the last estimate
NOISE_ROUND_TOLERANCE = 0.05  # relative decrease of E that ends a round, whose minimum need not be exact
# m; image noise from which further hypotheses are tried. Under less, a still camera is wrong too often: clean
# views from an orbiting camera had an error of 33 mm instead of 18.
MIN_NOISE_FOR_HYPOTHESES = 0.03
# relative decrease of E; hypotheses compared before they had converged selected half the true cadence.
HYPOTHESIS_TOLERANCE = 2e-3
INITIAL_TRANSLATION_STEPS = 2  # the first least squares step is not yet at the optimum of the robust loss


@dataclass(frozen=True, eq=False)
class EstimatedPoses:
    """Poses of the frames of a window under any model, from which the periodic solver starts."""

    joints: Array  # (F, J, 3) m, along the axes of the camera optical frame
    scale: Array  # (F,) px/m, scales of the cameras
    noise: float  # m, standard deviation of a coordinate of an image point of weight 1
    jitter: float = 0.0  # m, RMS distance of a joint's image from where it would be without jitter


@dataclass(frozen=True, eq=False)
class PeriodicReconstruction(Reconstruction):
    """Reconstruction under the periodic model. Its objective never rises."""

    noise: float  # m, standard deviation of a coordinate of a point of weight 1
    cadence: float  # Hz, full cycles (two steps of a walk) per second
    series: FourierSeries  # Fourier series of the weights and the heading


def solve(
    window: Window, model: BasePoses, config: SolverConfig, initial: EstimatedPoses | None = None
) -> PeriodicReconstruction:
    """Reconstruct a window under the periodic model.

    `window` image points of a cycle or more. Times may be irregular. Lifted poses, fixed frames and earlier frames
    are ignored; `config` weights of the terms, and `harmonics`. `max_iterations` limits the number of steps that
    are tried, in all searches together; `initial` poses from which to start, None computes them.

    Raises:
        InputError: the equations cannot be solved, or the result is not finite because numbers are too large.
    """
    return run_to_end(solve_stepwise(window, model, config, initial))


def solve_stepwise(
    window: Window, model: BasePoses, config: SolverConfig, initial: EstimatedPoses | None = None
) -> Stepwise[PeriodicReconstruction]:
    """Reconstruct as `solve` does, in steps."""
    window, model = replace(window, lifted=None), model.truncate(config.components)
    try:  # numbers that overflow are found in the result
        result = yield from ignore_overflow(_solve(window, model, config, initial))
    except LinAlgError as error:
        raise InputError(f'no periodic motion can be fitted: {error}') from None
    numbers = (result.joints, result.cameras.scale, result.translation, result.series.coefficients, result.history)
    if not all(np.isfinite(n).all() for n in numbers):
        raise InputError('no periodic motion can be fitted: image points or weights are too large')
    return result


def _solve(
    window: Window, model: BasePoses, config: SolverConfig, initial: EstimatedPoses | None
) -> Stepwise[PeriodicReconstruction]:
    start, noise = yield from _choose_initial_values(window, initial, model, config)
    unit = window.unit or float(np.median(start.cameras.scale))
    return (yield from _fit_window(window, start, noise, unit, model, config))


def _choose_initial_values(
    window: Window, initial: EstimatedPoses | None, model: BasePoses, config: SolverConfig
) -> Stepwise[tuple[InitialValues, float]]:
    """Return weights of this model's base poses and cameras, and the image noise (m).

    They are those of the given poses, or if these are None those of a few steps of the joint solver.
    """
    if initial is None:
        short = replace(config, max_iterations=min(MAX_INITIAL_ITERATIONS, config.max_iterations))
        (coarse,) = yield from joint.solve_stepwise([window], model, short)
        return InitialValues(coarse.theta, coarse.cameras), coarse.noise
    to_body = fit_rotation(initial.joints, model.mean)
    theta = model.weights(initial.joints @ np.swapaxes(to_body, -1, -2))
    cameras = WeakPerspectiveCameras(initial.scale, np.swapaxes(to_body, -1, -2))
    return InitialValues(theta, cameras), initial.noise


def _fit_window(
    window: Window,
    start: InitialValues,
    noise: float,
    unit: float,
    model: BasePoses,
    config: SolverConfig,
) -> Stepwise[PeriodicReconstruction]:
    """Carry out steps 2 to 4 of the head of this module; `noise` in m, `unit` in px/m."""
    noise = float(np.fmax(window.noise or noise, config.noise_floor))
    objective = PeriodicObjective.build(window, unit, model, config)
    if config.adapt_noise:
        objective.set_noise(noise)
    yield
    searches, hypotheses = [], fit_initial_series(start.theta, window.times, config)
    for series in hypotheses[: 1 if noise < MIN_NOISE_FOR_HYPOTHESES else 2]:
        yield
        point = measure_initial_point(objective, series, start, unit)
        searches.append(Search(objective, point, config.max_iterations))
        yield
    search = yield from select_most_likely(searches)
    if noise >= MIN_NOISE_FOR_HYPOTHESES:
        on_stand = objective.with_still_camera(config)
        point = on_stand.measure(search.point.series, search.point.cameras, settle_steps=0)
        still = Search(on_stand, point, search.remaining_trials)
        search = yield from select_most_likely([search, still])
    if config.adapt_noise and window.noise is None:
        for _ in range(NOISE_ROUNDS):
            yield from search.run(max(NOISE_ROUND_TOLERANCE, config.tolerance))
            yield
            noise = max(search.estimate_noise(), config.noise_floor)
            search.set_noise(noise)
            yield
    yield from search.run(config.tolerance)
    yield
    iterations = config.max_iterations - search.remaining_trials
    result = search.make_reconstruction(window, unit, iterations)
    series = search.point.series
    return PeriodicReconstruction(**vars(result), noise=noise, cadence=series.cadence, series=series)


def measure_initial_point(
    objective: PeriodicObjective, series: FourierSeries, start: InitialValues, unit: float
) -> Point:
    """Return a point with the cameras C_t = R_t Rz(-psi_t) for the initial rotations R_t, translations optimal."""
    batch = objective.body.batch
    body = batch.initial_state([start], np.array([unit]))
    without_heading = rotations_about_vertical(-series.evaluate_heading(batch.times))
    cameras = body._replace(theta=np.zeros((len(batch.times), 0)), rotation=body.rotation @ without_heading)
    return objective.measure(series, cameras, INITIAL_TRANSLATION_STEPS)


class Search:
    """The minimisation that starts from one hypothesis, in several runs of Levenberg-Marquardt.

    Attributes:
        objective: the objective E; its compiled problem is shared with the other searches.
        point: current series and cameras.
        equations: normal equations at the current point or at an earlier one; None before the first run.
        history: m^2, values of E since the current noise was set, after each step that was tried.
        damping: relative damping of the next step.
        remaining_trials: number of steps that may still be tried, accepted or not.
        status: why the latest run stopped.
    """

    def __init__(self, objective: PeriodicObjective, point: Point, max_trials: int) -> None:
        self.objective, self.point, self.history = objective, point, [point.cost]
        self.equations: PeriodicEquations | None = None
        self.damping = WARM_DAMPING
        self.remaining_trials = max_trials
        self.status = SolverStatus.MAX_ITERATIONS

    def set_noise(self, noise: float) -> None:
        """Continue from the current point under another image noise (m); only after the selection."""
        self.objective.set_noise(noise)
        self.point = self.objective.measure(self.point.series, self.point.cameras, settle_steps=0)
        self.history = [self.point.cost]

    @property
    def cost(self) -> Array:
        """Objective (1,) at the current point."""
        return np.array([self.point.cost])

    def begin(self, damping: float) -> None:
        """Set the damping of the first step, and compute the normal equations."""
        self.damping = damping
        self.update_equations()

    def update_equations(self) -> None:
        """Compute the normal equations at the current point."""
        self.equations = self.objective.normal_equations(self.point)

    def try_steps(self, tolerance: float) -> tuple[int, int]:
        """Try a step; return whether it was taken, and whether it was not the last (`Problem.try_steps`)."""
        step = self._some_equations().solve_step(self.damping)
        trial = self.point if step is None else self.objective.advance(self.point, step)
        before, is_better = self.point.cost, trial.cost < self.point.cost
        self.remaining_trials -= 1
        if is_better:
            self.point = trial
        if is_better and before - trial.cost <= tolerance * trial.cost:
            self.status = SolverStatus.CONVERGED
            return 1, 0
        if self.damping > MAX_DAMPING:
            is_minimum = step is not None and np.isfinite(before)
            self.status = SolverStatus.NO_LOWER_STEP if is_minimum else SolverStatus.SINGULAR
            return int(is_better), 0
        self.status = SolverStatus.SINGULAR if step is None else SolverStatus.MAX_ITERATIONS
        factor = DAMPING_AFTER_SUCCESS if is_better else DAMPING_AFTER_FAILURE
        self.damping = max(self.damping * factor, MIN_DAMPING)
        return int(is_better), 1

    def run(self, tolerance: float) -> Stepwise[None]:
        """Minimise until a step decreases E by less than the relative tolerance, or no trials remain."""
        if self.remaining_trials == 0:
            self.status = min(self.status, SolverStatus.MAX_ITERATIONS)
            return
        history = yield from minimise_stepwise(self, self.remaining_trials, tolerance, self.damping)
        self.history += [float(cost[0]) for cost in history[1:]]
        if self.status is SolverStatus.CONVERGED:
            self.damping = max(self.damping * DAMPING_AFTER_SUCCESS, MIN_DAMPING)

    def make_reconstruction(self, window: Window, unit: float, iterations: int) -> Reconstruction:
        """Return the reconstruction of a window at the current point; `unit` in px/m."""
        problem = self.objective.problem
        problem.start(*self.point.body)
        return make_reconstruction(problem, window, unit, self.status, self.history, iterations)

    def estimate_noise(self) -> float:
        """Return the image noise (m); the effective parameters may be those of the point before the last step."""
        return self.objective.estimate_noise(self.point, self._some_equations().count_effective_parameters())

    def minus_twice_log_evidence(self) -> float:
        """Return the value at the head of this module; C may be that of the point before the last step."""
        return self.history[-1] / NOISE_REFERENCE**2 + self._some_equations().camera_log_determinant_ratio()

    def _some_equations(self) -> PeriodicEquations:
        """Return the equations of the latest run, or those of the current point if there was no run."""
        if self.equations is None:
            self.equations = self.objective.normal_equations(self.point)
        return self.equations


def select_most_likely(hypotheses: Sequence[Search]) -> Stepwise[Search]:
    """Run the searches almost to convergence and return the one with the highest evidence.

    All searches together have the trials of the first one; what remains of these is left to the selected one.
    """
    if len(hypotheses) == 1:
        return hypotheses[0]
    remaining_trials = hypotheses[0].remaining_trials
    for search in hypotheses:
        search.remaining_trials = remaining_trials
        yield from search.run(HYPOTHESIS_TOLERANCE)
        yield
        remaining_trials = search.remaining_trials
    best = min(hypotheses, key=Search.minus_twice_log_evidence)
    best.remaining_trials = remaining_trials
    return best
