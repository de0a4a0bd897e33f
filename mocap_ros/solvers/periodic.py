# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The periodic model (TPAMI 2016, section 3.3): Levenberg-Marquardt over Fourier series and cameras.

It minimises the objective E of `periodic_equations` over the coefficients of the series, their frequency omega and
the cameras. The base-pose weights and the heading are Fourier series of time,

    u_l(t) = c_0l + sum_h [a_hl cos(h omega (t - t0)) + b_hl sin(h omega (t - t0))],    h = 1 ... H

for l = 1 ... K (weights, m) and l = K + 1 (heading, rad), with one fundamental frequency omega (eq. 17 has one for
each) and t0 the mean of the times. They are linear in the P = 2 H + 1 coefficients, u_l(t) = sum_p terms_tp c_pl,
whose order is constant, cos, sin, cos 2, sin 2 and so on. The prior of the coefficients counts once a window: the
variance of a weight is shared among the terms of its series, with less for constants.

1. Initial values: the weights theta of poses found without periodicity; a series fitted to them, its cadence
   from a scan (`fit_initial_series`).
2. Hypotheses, if the noise is large: a second cadence, and a camera that hardly moves. E is minimised from each,
   and the one with the highest evidence is kept, the cameras integrated over by Laplace's method:

       -2 log p(x | hypothesis) = min E / (10 mm)^2 + log det C - log det C_prior + constant

   with C the normal matrix of the cameras and C_prior the part of it that does not come from the image.
3. Image noise: the noise is estimated from the residual and E is minimised under it, in alternation.
4. E is minimised under the final noise. Every step eliminates the cameras, 4 unknowns a frame, which leaves a
   dense system of (2 H + 1) (K + 1) + 1 unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError

from mocap_ros.arrays import Array, copy_with
from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint as engine
from mocap_ros.engine import terms
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers import joint
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE, list_terms, pose_problem, read_state
from mocap_ros.solvers.joint.solver import WARM_DAMPING, describe_frames
from mocap_ros.solvers.levenberg_marquardt import Stepwise, minimise_stepwise, run_to_end
from mocap_ros.solvers.periodic_equations import PeriodicProblem, Point, fit_series
from mocap_ros.solvers.window import InitialValues, Reconstruction, SolverStatus, Window, interpolate_unseen

MAX_INITIAL_ITERATIONS = 12  # steps of the joint solver for initial values; a coarse result is sufficient
NOISE_ROUNDS = 2  # estimates of the image noise, each after a minimisation under the last estimate
NOISE_ROUND_TOLERANCE = 0.05  # relative decrease of E that ends a round, whose minimum need not be exact
# m; image noise from which further hypotheses are tried. Under less, a still camera is wrong too often: clean
# views from an orbiting camera had an error of 33 mm instead of 18.
MIN_NOISE_FOR_HYPOTHESES = 0.03
# relative decrease of E; hypotheses compared before they had converged selected half the true cadence.
HYPOTHESIS_TOLERANCE = 2e-3
INITIAL_TRANSLATION_STEPS = 2  # the first least squares step is not yet at the optimum of the robust loss
MIN_CADENCE_HZ = 0.5  # Hz, full cycles; the slowest walk, as `ClassifierConfig.walk_cadence`
MAX_CADENCE_HZ = 2.2  # Hz, full cycles; about that of a sprint
CADENCE_STEP_HZ = 0.02  # Hz; half a step shifts the phase over a window of 2 s by 2 % of a cycle
MIN_CYCLES = 0.8  # cycles in the window; a lower cadence would look like a drift
MIN_LOG_CADENCE_RATIO = 0.25  # a second cadence differs by a factor of 1.28, or it would end in the same minimum
RIDGE = 0.2  # weight of c^T diag(1 / share) c against the mean squared misfit; chosen on CMU walks and runs
# Shares of a weight's variance over time and persons, chosen on CMU walks and runs.
CONSTANT_SHARE = 0.4  # of the constant term
HARMONIC_SHARE = 0.4  # of the first harmonic; the h-th has 1 / h^2 of it
# Properties of walks and runs.
MODEL_ERROR = 0.01  # m; error of a coordinate from what a periodic motion cannot explain, added to the image noise
STILL_CAMERA_FACTOR = 300.0  # on the weight of the camera's velocity if the camera is supposed to stand still
CONSTANT_STD = 0.008  # m; of the constant coefficients: a person's mean pose is near that of the model
HEADING_STD = 0.25  # rad; of the heading: the body turns by 7 degrees RMS in CMU walks, by 15 in runs
CONSTANT_HEADING_STD = 1e-3  # rad; of the constant of the heading: the rotation of the camera already contains it
LEVEL_STD = 0.17  # rad; of the tilt of the camera: 10 degrees, a weak prior


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


def solve(
    window: Window, model: PoseModel, config: SolverConfig, initial: EstimatedPoses | None = None
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
    window: Window, model: PoseModel, config: SolverConfig, initial: EstimatedPoses | None = None
) -> Stepwise[PeriodicReconstruction]:
    """Reconstruct as `solve` does, in steps."""
    try:  # numbers that overflow are found in the result
        result = yield from _solve(
            copy_with(window, lifted=None), model.truncate(config.components), config, initial
        )
    except LinAlgError as error:
        raise InputError(f'no periodic motion can be fitted: {error}') from None
    numbers = result.joints, result.cameras.scale, result.translation, result.theta, result.history
    if not all(np.isfinite(n).all() for n in numbers):
        raise InputError('no periodic motion can be fitted: image points or weights are too large')
    return result


def _solve(
    window: Window, model: PoseModel, config: SolverConfig, initial: EstimatedPoses | None
) -> Stepwise[PeriodicReconstruction]:
    start, noise = yield from _choose_initial_values(window, initial, model, config)
    unit = window.unit or float(np.median(start.cameras.scale))
    noise = float(np.fmax(window.noise or noise, config.noise_floor))
    batch = Batch.build([window], np.array([unit]), [start])
    batch.sequences['noise_ratio'] = measure_noise_ratio(noise) if config.adapt_noise else 1.0
    body, cameras = build_body(batch, model, config), build_cameras(batch, model, config)
    yield
    searches, hypotheses = [], fit_initial_series(start.theta, window.times, config)
    for series in hypotheses[: 1 if noise < MIN_NOISE_FOR_HYPOTHESES else 2]:
        yield
        point = Point(*series, *batch.start[1:])
        problem = build_problem(body, cameras, point, model, config, INITIAL_TRANSLATION_STEPS)
        searches.append(Search(problem, config.max_iterations))
        yield
    search = yield from select_most_likely(searches)
    if noise >= MIN_NOISE_FOR_HYPOTHESES:
        cameras = build_cameras(batch, model, config, STILL_CAMERA_FACTOR)
        problem = build_problem(body, cameras, search.problem.point, model, config)
        still = Search(problem, search.remaining_trials)
        search = yield from select_most_likely([search, still])
    if config.adapt_noise and window.noise is None:
        for _ in range(NOISE_ROUNDS):
            yield from search.run(max(NOISE_ROUND_TOLERANCE, config.tolerance))
            yield
            noise = max(search.problem.estimate_noise(), config.noise_floor)
            search.set_noise(noise)
            yield
    yield from search.run(config.tolerance)
    yield
    search.problem.restart()
    joints, found, translation, residual = describe_frames(body, batch)
    return PeriodicReconstruction(
        joints=joints,
        theta=read_state(body).theta,
        cameras=found,
        translation=interpolate_unseen(translation, window),
        residual=residual,
        status=search.status,
        history=tuple(search.history),
        iterations=config.max_iterations - search.remaining_trials,
        noise=noise,
        cadence=search.problem.point.omega / (2 * np.pi),
    )


def _choose_initial_values(
    window: Window, initial: EstimatedPoses | None, model: PoseModel, config: SolverConfig
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


def fit_initial_series(theta: Array, times: Array, config: SolverConfig) -> list[tuple[Array, float]]:
    """Fit series to the weights of a non-periodic reconstruction, with the two most likely cadences of a scan.

    Returns the coefficients (P, K + 1) and omega in rad/s of each.

    For every cadence, with the diagonal ridge D = RIDGE N diag(1 / share_p), the coefficients minimise

        |theta_l - T c_l|^2 + c_l^T D c_l = |theta_l|^2 - c_l^T T^T theta_l    at  c_l = (T^T T + D)^-1 T^T theta_l

    so the best has the largest c^T T^T theta, summed over base poses. The heading begins as zero. The second
    cadence is the best of those unlike the first; it is the first if there are none.
    """
    scanned, count = list_scanned_frequencies(times), len(times)
    ridge = RIDGE * count / variance_shares(config.harmonics)
    fits, explained = fit_series(times - times.mean(), theta, scanned, ridge)
    first = explained.argmax()
    is_other = np.abs(np.log(scanned / scanned[first])) > MIN_LOG_CADENCE_RATIO
    second = np.where(is_other, explained, -np.inf).argmax() if is_other.any() else first
    heading = np.zeros((len(ridge), 1))
    return [(np.concatenate([fits[i], heading], axis=1), float(scanned[i])) for i in (first, second)]


def list_scanned_frequencies(times: Array) -> Array:
    """Return the frequencies (C,) in rad/s among which that of a window with these times (N,) s is searched."""
    span = max(float(np.ptp(times)), 1e-3)
    lowest = min(max(MIN_CADENCE_HZ, MIN_CYCLES / span), MAX_CADENCE_HZ)
    return 2 * np.pi * np.arange(lowest, MAX_CADENCE_HZ + CADENCE_STEP_HZ / 2, CADENCE_STEP_HZ)


def variance_shares(harmonics: int) -> Array:
    """Return the share (2 H + 1,) of a weight's variance that the prior gives to each term."""
    harmonic = HARMONIC_SHARE / np.arange(1, harmonics + 1) ** 2
    return np.append(CONSTANT_SHARE, np.repeat(harmonic, 2))


def measure_noise_ratio(noise: float) -> float:
    """Return the ratio to that of the reference of an image noise in m, to which `MODEL_ERROR` is added."""
    return float(np.hypot(noise, MODEL_ERROR)) / NOISE_REFERENCE


def build_body(batch: Batch, model: PoseModel, config: SolverConfig) -> engine.JointProblem:
    """Return the reprojection and the bone lengths of the only window of a batch."""
    batch.sequences['motion_share'] = 1.0
    return pose_problem(batch, model, list_terms(batch, model, config)[:2])


def build_cameras(
    batch: Batch, model: PoseModel, config: SolverConfig, velocity_factor: float = 1.0
) -> engine.JointProblem:
    """Return the movement and the tilt of the cameras of the only window of a batch."""
    of_image = np.repeat([1.0, 0.0], [6, 7])  # of the features: M
    movement: list[terms.Term] = [
        terms.Velocity(velocity_factor * config.camera_velocity_weight * of_image),
        terms.Acceleration(config.camera_acceleration_weight * of_image),
    ]
    if model.aligned_by_heading:
        movement.append(terms.Level(config.prior_weight / LEVEL_STD**2 / len(batch.times)))
    return pose_problem(batch, model, tuple(movement), 0)


def build_problem(
    body: engine.JointProblem,
    cameras: engine.JointProblem,
    start: Point,
    model: PoseModel,
    config: SolverConfig,
    settle_steps: int = 0,
) -> PeriodicProblem:
    """Return the objective of the window of a body and its cameras, at a point."""
    times = body.batch.frames['time']
    variance = variance_shares(config.harmonics)[:, None] * np.append(model.std, HEADING_STD) ** 2
    variance[0] = 1 / (1 / variance[0] + 1 / CONSTANT_STD**2)
    variance[0, -1] = CONSTANT_HEADING_STD**2
    prior = config.prior_weight * config.periodic_prior_factor / variance
    return PeriodicProblem(body, cameras, times - times.mean(), prior, start, settle_steps)


class Search:
    """The minimisation that starts from one hypothesis, in several runs of Levenberg-Marquardt.

    Attributes:
        problem: the objective E at the current point.
        history: m^2, values of E since the current noise was set, after each step that was tried.
        remaining_trials: number of steps that may still be tried, accepted or not.
        status: why the latest run stopped.
    """

    def __init__(self, problem: PeriodicProblem, max_trials: int) -> None:
        self.problem, self.remaining_trials, self.damping = problem, max_trials, WARM_DAMPING
        self.history, self.status = [float(problem.cost[0])], SolverStatus.MAX_ITERATIONS

    def set_noise(self, noise: float) -> None:
        """Continue from the current point under another image noise (m); only after the selection."""
        self.problem.body.batch.sequences['noise_ratio'] = measure_noise_ratio(noise)
        self.problem.restart()
        self.history = [float(self.problem.cost[0])]

    def run(self, tolerance: float) -> Stepwise[None]:
        """Minimise until a step decreases E by less than the relative tolerance, or no trials remain."""
        if self.remaining_trials == 0:
            self.status = min(self.status, SolverStatus.MAX_ITERATIONS)
            return
        history = yield from minimise_stepwise(self.problem, self.remaining_trials, tolerance, self.damping)
        self.history += history[1:, 0].tolist()
        self.remaining_trials -= len(history) - 1
        search = self.problem.search[0]
        self.damping, self.status = float(search['damping']), SolverStatus(search['status'])

    def minus_twice_log_evidence(self) -> float:
        """Return the value at the head of this module; C may be that of the point before the last step."""
        return self.history[-1] / NOISE_REFERENCE**2 + self.problem.camera_log_determinant_ratio()


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
