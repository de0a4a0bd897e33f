# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The image noise of each window, estimated while the objective is minimised, from a large noise down.

The noise weighs the reprojection against all other terms (`objective`). Its estimate is the root mean square of
the reprojection errors over the coordinates that the unknowns have not absorbed; objective and estimate are
improved in turn. Under large noise the priors hold the weights, the cameras settle first, and few local minima are
left. So the rounds begin with a noise of 50 mm, on a tenth of a second's best-seen frame each and with only those
base poses that vary by a good part of the noise, and end with all frames and all base poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.solvers.joint.batch import MIN_TIME_STEP, Batch, Subsample
from mocap_ros.solvers.joint.noise_estimate import estimate_noise
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.problem import Descent, JointProblem
from mocap_ros.solvers.joint.state import Fit, State
from mocap_ros.solvers.levenberg_marquardt import minimise_stepwise
from mocap_ros.solvers.stepwise import Stepwise
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

# m, least noise of each round; each about half the one before, so that the residual can follow
COARSE_NOISE_M = (0.05, 0.025, 0.012)  # rounds on some frames and base poses
FINE_NOISE_M = (0.006, 0.003)  # rounds on all of them; a last one has no least noise but `noise_floor`
COARSE_FRAME_STEP_S = 0.1  # s between the frames of the coarse rounds: people hardly move in less
ROUND_TOLERANCE = 0.05  # relative decrease that ends a round: its result is only the next one's start
MIN_STD_OVER_NOISE = 0.3  # base poses that vary by less than this share of the noise are not worth solving for
MIN_COMPONENTS = 5  # base poses that are always solved for: the paper finds 4 to 10 best without a prior
COLD_DAMPING = 0.1  # first damping where nothing has been solved yet; tuned on CMU views, as the next
CONTINUED_DAMPING = 1e-4  # first damping where a round goes on from the one before


Annealed: TypeAlias = tuple[JointObjective, Fit, NDArray[np.int64]]


def anneal_stepwise(
    objective: JointObjective, fit: Fit, windows: Sequence[Window], config: SolverConfig
) -> Stepwise[Annealed]:
    """Find the noise of each window that does not give it, in steps.

    Args:
        objective: of the windows, under the reference noise.
        fit: of the initial values of the unknowns.
        windows: the sequences; `Window.noise` in m is taken as it is where it is given.
        config: of the solver.

    Returns:
        The objective under the noise that was found, the fit, and the number of steps of each sequence (P,).
    """
    noise = np.array([max(w.noise or COARSE_NOISE_M[0], config.noise_floor) for w in windows])
    is_unknown = np.array([w.noise is None for w in windows])
    if not is_unknown.any():
        if objective.limits_accelerations:
            kept = _choose_coarse_frames(objective)
            objective = objective.with_activity(fit.state.select(kept.frames), kept.batch)
        return objective.with_noise(noise), fit, np.zeros(len(windows), np.int64)

    def updated_noise(current: JointObjective, descent: Descent, least: float) -> Array:
        estimate = estimate_noise(
            current.reprojection, current.batch, current.is_free, descent.point, descent.equations
        )
        return np.where(is_unknown, np.maximum(estimate, max(least, config.noise_floor)), noise)

    tolerance = max(ROUND_TOLERANCE, config.tolerance)
    kept = _choose_coarse_frames(objective)
    coarse_objective = objective.subsampled(kept)
    coarse = fit.state.select(kept.frames)
    damping = COLD_DAMPING
    iterations = np.zeros(len(windows), np.int64)
    for level, least in zip(COARSE_NOISE_M, (*COARSE_NOISE_M[1:], FINE_NOISE_M[0]), strict=True):
        k = max(int((objective.model.std >= MIN_STD_OVER_NOISE * level).sum()), MIN_COMPONENTS)
        current = coarse_objective.with_noise(noise).with_components(k)
        start = current.fit(coarse.with_components(k))
        descent = yield from minimise_stepwise(
            JointProblem(current), start, config.max_iterations, tolerance, damping
        )
        iterations += descent.iterations
        coarse = coarse.with_leading_weights(descent.point.state)
        noise = updated_noise(current, descent, least)
        damping = CONTINUED_DAMPING
        yield
    objective = objective.with_activity(coarse, kept.batch)
    fit = objective.with_optimal_translation(interpolate(coarse, kept.frames, objective.batch))
    for least in (*FINE_NOISE_M[1:], 0.0):
        current = objective.with_noise(noise)
        descent = yield from minimise_stepwise(
            JointProblem(current), fit, config.max_iterations, tolerance, damping
        )
        iterations += descent.iterations
        fit, before = descent.point, noise
        noise = updated_noise(current, descent, least)
        yield
        if np.array_equal(noise, before):
            break
    return objective.with_noise(noise), fit, iterations


def _choose_coarse_frames(objective: JointObjective) -> Subsample:
    """Return the best-seen frame of every `COARSE_FRAME_STEP_S`."""
    return objective.batch.subsample(COARSE_FRAME_STEP_S, objective.reprojection.weight.sum(axis=1))


def interpolate(coarse: State, frames: NDArray[np.intp], batch: Batch) -> State:
    """Interpolate the state of some frames in time to all frames of the batch.

    Weights, logarithms of the scale and translations are interpolated linearly, rotations at constant angular
    velocity; frames outside those given take the nearest one of their sequence.

    Args:
        coarse: state of the frames.
        frames: (M,) indices of them.
        batch: all frames.
    """
    sequence = batch.sequence
    every = np.arange(len(sequence))
    after = np.minimum(np.searchsorted(frames, every), len(frames) - 1)
    before = np.maximum(np.searchsorted(frames, every, side='right') - 1, 0)
    coarse_sequence = sequence[frames]
    before = np.where(coarse_sequence[before] == sequence, before, after)
    after = np.where(coarse_sequence[after] == sequence, after, before)
    t, t0, t1 = batch.times, batch.times[frames[before]], batch.times[frames[after]]
    share = np.clip((t - t0) / np.maximum(t1 - t0, MIN_TIME_STEP), 0.0, 1.0)
    first, last = coarse.select(before), coarse.select(after)
    turn = vector_from_rotation(last.rotation @ np.swapaxes(first.rotation, -1, -2))
    return State(
        first.theta + share[:, None] * (last.theta - first.theta),
        rotation_from_vector(share[:, None] * turn) @ first.rotation,
        first.log_scale + share * (last.log_scale - first.log_scale),
        first.translation + share[:, None] * (last.translation - first.translation),
    )
