# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The image noise of each window, estimated while the objective is minimised, from a large noise down.

It weighs the reprojection against all other terms (`objective`), and is estimated from the residual, shared among
the coordinates that the unknowns have not absorbed:

    noise^2 = sum_tj w_tj rho(|e_tj|^2) / (2 S - m),    m = F / |T| sum_(t in T) m_t

over the S seen joints of a sequence, with m_t the coordinates that the unknowns of frame t fit away while its
neighbours are held, counted in some free frames T.

Errors of a detector wander for some tenths of a second, or stay. Poses follow these, the more so the fewer joints
there are, so the residual shows too little of them. But they are some times what is new in every frame, which the
points show by themselves. So with lifted poses

    noise >= g (q^2 - q_0^2)^(1/2),    q^2 = mean_tj w_tj rho(|d_tj|^2 / 20) / 2
    d_tj = x_tj - 3 x_(t-1)j + 3 x_(t-2)j - x_(t-3)j
    g = 1 for r >= r_w,    G for r <= 1 / 6,    linear between,    r = corr(d_t, d_(t-2))

with x the points at 30 Hz and q_0 the q of people who move without noise. The correlation r is 3/10 of noise that
is new in every frame and 1/6 of a random walk; live it is that of all frames of the window. G, r_w and the
constants of rho were measured on the protocol's and on recorded detectors.

Under large noise the priors hold the weights and few local minima are left. So the rounds begin with 50 mm, on the
best-seen frame of each tenth of a second and the base poses that vary by a good part of the noise, and end with
all frames and all base poses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint as engine
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers.joint.activity import measure_activities
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.joint.objective import list_terms, pose_problem, read_state, set_noise
from mocap_ros.solvers.levenberg_marquardt import Stepwise, minimise_stepwise
from mocap_ros.solvers.window import Window

# m, least noise of each round; each about half the one before, so that the residual can follow
COARSE_NOISE_M = (0.05, 0.025, 0.012)  # rounds on some frames and base poses
FINE_NOISE_M = (0.006, 0.003)  # rounds on all of them; a last one has no least noise but `noise_floor`
COARSE_FRAME_STEP_S = 0.1  # s between the frames of the coarse rounds: people hardly move in less
ROUND_TOLERANCE = 0.05  # relative decrease that ends a round: its result is only the next one's start
MIN_STD_OVER_NOISE = 0.3  # base poses that vary by less than this share of the noise are not worth solving for
MIN_COMPONENTS = 5  # base poses that are always solved for: the paper finds 4 to 10 best without a prior
COLD_DAMPING = 0.1  # first damping where nothing has been solved yet; tuned on CMU views, as the next
CONTINUED_DAMPING = 1e-4  # first damping where a round goes on from the one before


def get_given_noise(windows: Sequence[Window], config: SolverConfig) -> Array:
    """Return the noise (P,) m that the windows give; the largest where it is to be found."""
    return np.array([max(w.noise or COARSE_NOISE_M[0], config.noise_floor) for w in windows])


def anneal_stepwise(
    batch: Batch, state: State, model: PoseModel, windows: Sequence[Window], config: SolverConfig
) -> Stepwise[tuple[engine.JointProblem, NDArray[np.int64], tuple[Array, Array] | None]]:
    """Find the noise of each window that does not give it, in steps.

    Returns the problem under this noise, at the point that was reached, the number of steps of each sequence, and
    the activities (`measure_activities`) of all frames, if accelerations count.
    """
    noise, is_unknown = get_given_noise(windows, config), np.array([w.noise is None for w in windows])

    def update_noise(problem: engine.JointProblem, least: float) -> Array:
        estimate = np.maximum(problem.measure_misfit(), problem.batch.sequences['least_noise'])
        estimate = np.maximum(estimate, max(least, config.noise_floor))
        return np.where(is_unknown, estimate, noise)

    tolerance, damping = max(ROUND_TOLERANCE, config.tolerance), COLD_DAMPING
    iterations = np.zeros(len(windows), np.int64)
    frames = batch.find_best_seen(COARSE_FRAME_STEP_S)
    some, coarse = batch.select(frames), state.select(frames)
    for level, least in zip(COARSE_NOISE_M, (*COARSE_NOISE_M[1:], FINE_NOISE_M[0]), strict=True):
        k = max(int((model.std >= MIN_STD_OVER_NOISE * level).sum()), MIN_COMPONENTS)
        k = min(k, len(model.std))
        terms = list_terms(some, model, config, components=k, has_limits=False)
        problem = pose_problem(some, model, terms, k)
        set_noise(some, noise)
        problem.start(*coarse._replace(theta=coarse.theta[:, :k]))
        yield from minimise_stepwise(problem, config.max_iterations, tolerance, damping)
        iterations += problem.searches['iterations']
        found = read_state(problem)
        coarse = found._replace(theta=np.concatenate([found.theta, coarse.theta[:, k:]], axis=1))
        noise, damping = update_noise(problem, least), CONTINUED_DAMPING
        yield
    activity = measure_activities(coarse, some, batch) if config.pose_acceleration_weight > 0 else None
    problem = pose_problem(batch, model, list_terms(batch, model, config, activity=activity))
    set_noise(batch, noise)
    problem.start(*batch.interpolate(coarse, frames), settle_steps=1, at_reference=True)
    for least in (*FINE_NOISE_M[1:], 0.0):
        yield from minimise_stepwise(problem, config.max_iterations, tolerance, damping)
        iterations += problem.searches['iterations']
        before, noise = noise, update_noise(problem, least)
        set_noise(batch, noise)
        problem.start(*read_state(problem))
        yield
        if np.array_equal(noise, before):
            break
    return problem, iterations, activity
