# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The non-periodic model solved jointly for cameras and base-pose weights (TPAMI 2016, section 3.4).

The paper alternates between cameras and weights (`alternation`). Here one Levenberg-Marquardt minimises
`objective` over both at once, for any number of people and hypotheses in one batch. The image noise, which the
weights of the terms are relative to, is found on the way (`noise_annealing`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, copy_with
from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint as engine
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers.joint.activity import measure_activities
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.lifted_start import fit_lifted_poses
from mocap_ros.solvers.joint.noise_annealing import (
    COARSE_FRAME_STEP_S,
    COLD_DAMPING,
    CONTINUED_DAMPING,
    anneal_stepwise,
    get_given_noise,
)
from mocap_ros.solvers.joint.objective import (
    NOISE_REFERENCE,
    list_terms,
    pose_problem,
    read_state,
    set_noise,
)
from mocap_ros.solvers.levenberg_marquardt import Stepwise, minimise_stepwise, run_to_end
from mocap_ros.solvers.window import (
    Reconstruction,
    SolverStatus,
    Window,
    choose_initial_values,
    interpolate_unseen,
    reverse_depth,
)

MANY_FRAMES = 10**7  # frames that given bone lengths count for, so many that they are the mean lengths
WARM_DAMPING = 1e-2  # first damping from the solution of the last frame; tuned on live walks and runs


class SharedValues(NamedTuple):
    """What the frames of a window share with others of the same sequence, or was found with these."""

    least_noise: float  # m, that the points of the sequence show by themselves (`noise_annealing`)
    bone_lengths: Array | None = None  # (B,) m, mean lengths of the bones; None for those of the window
    activity: tuple[Array, Array] | None = None  # as of `JointReconstruction`; None to measure it


@dataclass(frozen=True, eq=False)
class JointReconstruction(Reconstruction):
    """Reconstruction by the joint solver. Its objective never rises."""

    noise: float  # m, standard deviation of a coordinate of a point of weight 1 (`noise_annealing`)
    misfit: float  # m, the same by the residual alone: how well poses explain the image
    # (J,) m, posterior standard deviation (root of the trace of the covariance) of each joint of the last frame
    # relative to the origin of the body frame; None where the equations are singular
    joint_std: Array | None
    # mean square accelerations (F,) m^2/s^4 of poses and (F,) 1/s^4 of cameras, by which accelerations were
    # weighed; None where they are not kept
    activity: tuple[Array, Array] | None = None


def solve(
    windows: Sequence[Window], model: PoseModel, config: SolverConfig, shared: SharedValues | None = None
) -> tuple[JointReconstruction, ...]:
    """Reconstruct many sequences as one batch.

    A window without initial values starts from its lifted poses or, without these, from the mean pose. `shared`
    are values that the windows, all of one sequence, share with others of it.

    Raises:
        InputError: no frame of a window has four seen joints, or only some of the windows have lifted poses.
    """
    return run_to_end(solve_stepwise(windows, model, config, shared))


def solve_stepwise(
    windows: Sequence[Window], model: PoseModel, config: SolverConfig, shared: SharedValues | None = None
) -> Stepwise[tuple[JointReconstruction, ...]]:
    """Reconstruct as `solve` does, in steps."""
    if config.components < len(model.std):
        model = model.truncate(config.components)
    is_warm = all(w.start is not None and (w.noise is not None or not config.adapt_noise) for w in windows)
    windows = [start_from_lifted_poses(w, model) for w in windows]
    chosen = [choose_initial_values(w, model, config.start_window) for w in windows]
    yield
    batch = Batch.build(windows, np.array([unit for _, unit in chosen]), [start for start, _ in chosen])
    if shared is not None:
        batch.sequences['least_noise'] = shared.least_noise
    if shared is not None and shared.bone_lengths is not None:
        batch.sequences['earlier_lengths'], batch.sequences['earlier_frames'] = shared.bone_lengths, MANY_FRAMES
    activity = None if shared is None else shared.activity
    settle_steps = 1 if is_warm else 2
    earlier_iterations = np.zeros(len(windows), np.int64)
    damping = WARM_DAMPING if is_warm else CONTINUED_DAMPING if config.adapt_noise else COLD_DAMPING
    if config.adapt_noise and any(w.noise is None for w in windows):
        settled = read_state(continue_from(batch, None, model, config, settle_steps))
        yield
        annealed = anneal_stepwise(batch, settled, model, windows, config)
        problem, earlier_iterations, activity = yield from annealed
    else:
        noise = get_given_noise(windows, config) if config.adapt_noise else None
        problem = continue_from(batch, noise, model, config, settle_steps, activity)
        yield
    history = yield from minimise_stepwise(problem, config.max_iterations, config.tolerance, damping)
    yield
    return make_reconstructions(problem, batch, windows, history, earlier_iterations, activity)


def continue_from(
    batch: Batch,
    noise: Array | None,
    model: PoseModel,
    config: SolverConfig,
    settle_steps: int = 1,
    activity: tuple[Array, Array] | None = None,
) -> engine.JointProblem:
    """Return the problem of a batch at its start under image noise (P,) m; None for the reference.

    `activity` is that of `JointReconstruction`; None to measure it.
    """
    if noise is not None:
        set_noise(batch, noise)
        if activity is None and config.pose_acceleration_weight > 0:
            frames = batch.find_best_seen(COARSE_FRAME_STEP_S)
            activity = measure_activities(batch.start.select(frames), batch.select(frames), batch)
    problem = pose_problem(batch, model, list_terms(batch, model, config, activity=activity))
    problem.start(*batch.start, settle_steps=settle_steps, at_reference=True)
    return problem


def solve_hypotheses(
    windows: Sequence[Window], model: PoseModel, config: SolverConfig, shared: SharedValues | None = None
) -> tuple[JointReconstruction, ...]:
    """Reconstruct each window from one or two initial cameras, all in one batch, and return the likelier results.

    The second camera is the Necker reversal of the first. `config.hypotheses` is the number of cameras, or
    `config.heading_hypotheses` for base poses aligned by heading: those of all motions need it for people seen
    from the front or from behind (docs/method.md). Lifted poses separate these already, so one start is enough.
    """
    return run_to_end(solve_hypotheses_stepwise(windows, model, config, shared))


def solve_hypotheses_stepwise(
    windows: Sequence[Window], model: PoseModel, config: SolverConfig, shared: SharedValues | None = None
) -> Stepwise[tuple[JointReconstruction, ...]]:
    """Reconstruct as `solve_hypotheses` does, in steps."""
    count = config.heading_hypotheses if model.aligned_by_heading else config.hypotheses
    if all(w.lifted is not None for w in windows):
        count = 1
    if count == 1:
        return (yield from solve_stepwise(windows, model, config, shared))
    batch: list[Window] = []
    for window in windows:
        start, unit = choose_initial_values(window, model.truncate(config.components), config.start_window)
        batch += [copy_with(window, start=s, unit=unit) for s in (start, reverse_depth(start))]
        yield
    results = yield from solve_stepwise(batch, model, config, shared)
    return tuple(
        min(pair, key=lambda r: negative_log_posterior(r, w, config))
        for pair, w in zip(zip(results[::2], results[1::2], strict=True), windows, strict=True)
    )


def start_from_lifted_poses(window: Window, model: PoseModel) -> Window:
    """Return the window with initial values from its lifted poses, if it has such poses and no initial values."""
    if window.start is not None or window.lifted is None:
        return window
    return copy_with(window, start=fit_lifted_poses(window.lifted, window.times, model))


def negative_log_posterior(result: JointReconstruction, window: Window, config: SolverConfig) -> float:
    """Return minus twice the log posterior, up to a constant; it compares results under different noise."""
    if not config.adapt_noise:
        return result.cost / NOISE_REFERENCE**2
    noise = max(result.noise, config.noise_floor)
    coordinates = 2 * int((window.weight > 0).sum())
    return result.cost / NOISE_REFERENCE**2 + 2 * coordinates * math.log(noise / NOISE_REFERENCE)


def make_reconstructions(
    problem: engine.JointProblem,
    batch: Batch,
    windows: Sequence[Window],
    history: Array,
    earlier_iterations: NDArray[np.int64],
    activity: tuple[Array, Array] | None = None,
) -> tuple[JointReconstruction, ...]:
    """Return the reconstruction of each sequence of a batch."""
    joints, cameras, translation, residual = describe_frames(problem, batch)
    theta, misfit = read_state(problem).theta, problem.measure_misfit()
    joint_std = NOISE_REFERENCE * problem.measure_joint_std()
    noise = np.maximum(misfit, batch.sequences['least_noise'])
    costs, out = history.T.tolist(), []
    for i, own in enumerate(batch.slices):
        iterations = int(problem.searches['iterations'][i])
        out.append(
            JointReconstruction(
                joints=joints[own],
                theta=theta[own],
                cameras=WeakPerspectiveCameras(cameras.scale[own], cameras.rotation[own]),
                translation=interpolate_unseen(translation[own], windows[i]),
                residual=residual[own],
                status=SolverStatus(problem.searches['status'][i]),
                history=tuple(costs[i][: iterations + 1]),
                iterations=int(earlier_iterations[i]) + iterations,
                noise=float(noise[i]),
                misfit=float(misfit[i]),
                joint_std=None if np.isnan(joint_std[i, 0]) else joint_std[i],
                activity=None if activity is None else (activity[0][own], activity[1][own]),
            )
        )
    return tuple(out)


def describe_frames(
    problem: engine.JointProblem, batch: Batch
) -> tuple[Array, WeakPerspectiveCameras, Array, Array]:
    """Return joints (N, J, 3) m, cameras, translations (N, 2) px and residuals (N,) px of all frames.

    They are those of `solvers.window.Reconstruction`.
    """
    frames, is_seen = problem.frames, batch.frames['score'] > 0
    scale, units = np.exp(frames['log_scale']), batch.repeat_per_frame(batch.sequences['unit'])
    seen = is_seen.sum(axis=1)
    squares = np.where(is_seen, problem.measure_squared_errors(), 0.0).sum(axis=1)
    residual = np.where(seen > 0, units * np.sqrt(squares / np.maximum(seen, 1)), np.nan)
    cameras = WeakPerspectiveCameras(scale * units, frames['rotation'].copy())
    return frames['joints'] / scale[:, None, None], cameras, frames['translation'] * units[:, None], residual
