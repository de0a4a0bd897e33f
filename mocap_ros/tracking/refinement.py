# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The newest frames of tracked people, solved in one batch from the solution of the frames before.

A new frame at time t_n starts from a prediction by the last two solved frames:

    a       = EXTRAPOLATION_SHARE min((t_n - t_(n-1)) / (t_(n-1) - t_(n-2)), MAX_EXTRAPOLATION_STEPS)
    theta_n = theta_(n-1) + a (theta_(n-1) - theta_(n-2))                 weights of the base poses
    root_n  = root_(n-1) + a (root_(n-1) - root_(n-2))                    position of the body's origin
    R_n     = exp(a log(R_(n-1) R_(n-2)^T)) R_(n-1)                       rotation from body to camera

With a lifter, theta_n and R_n instead are those that fit the lifted pose of the new frame best (`lifted_start`).
Such a start owes nothing to earlier frames, so a wrong solution ends where the image speaks against it. With
points as detectors give them it lowers the errors of joints by 1 to 3 mm.

The first frames of a batch may be fixed: they keep their state, and the mean bone lengths of those before them
count. The image noise of a solution is averaged over the length of the window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint
from mocap_ros.engine import refinement as engine
from mocap_ros.models.base_poses import PoseModel, arrange_model
from mocap_ros.models.joint_std import HIDDEN_SHARE
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.lifted_start import prepare_fit
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE, set_noise
from mocap_ros.solvers.joint.solver import WARM_DAMPING, continue_from
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track

EXTRAPOLATION_SHARE = 0.7  # no unit; share of the last step that is repeated; less than 1 to amplify less noise
MAX_EXTRAPOLATION_STEPS = 2.0  # steps; limits the extrapolation after missing frames


@dataclass(eq=False)
class Refinement:
    """How people under one model are refined.

    The batch and its problem stay for the next one of as many frames of as many people.
    """

    model: PoseModel
    config: SolverConfig
    batch: Batch | None = None
    problem: joint.JointProblem | None = None


def refine(kept: Refinement, tracks: Sequence[Track], parts: Sequence[tuple[int, int]]) -> list[TrackSolution]:
    """Return the solutions of P tracks whose newest frame is not solved yet.

    The solutions so far are under the same model. `parts` has for each track the index of the first frame that is
    solved, and how many frames from there keep their state.
    """
    model, config = kept.model, kept.config
    batch = collect_newest_frames(tracks, parts, model, kept.batch)
    if batch is not kept.batch:
        kept.batch, kept.problem = batch, None
    noise = None
    if config.adapt_noise:
        noise = np.array([max(track.solved.noise, config.noise_floor) for track in tracks])
    problem = kept.problem
    if problem is None or config.pose_acceleration_weight > 0:
        kept.problem = problem = continue_from(batch, noise, model, config)
    else:
        if noise is not None:
            set_noise(batch, noise)
        problem.start(*batch.start, settle_steps=1, at_reference=True)
    problem.begin(WARM_DAMPING)
    for _ in range(config.max_iterations):
        if not problem.try_steps(config.tolerance)[1]:
            break
    before, arrays = [track.solved for track in tracks], arrange_model(model)
    finished = engine.finish_newest(
        batch,
        problem.frames,
        problem.measure_squared_errors(),
        [fixed for _, fixed in parts],
        [track.observed for track in tracks],
        before,
        model.skeleton.stature_per_bone,
        arrays.parents,
        arrays.children,
        HIDDEN_SHARE,
    )
    noises = np.maximum(problem.measure_misfit(), batch.sequences['least_noise']).tolist()
    joint_std, solutions = NOISE_REFERENCE * problem.measure_joint_std(), []
    for old, found, (first, fixed), noise_m, std in zip(before, finished, parts, noises, joint_std, strict=True):
        theta, rotation, roots, bone_lengths, residuals, stature, fit = found
        old_share = math.exp((first - len(theta)) / len(theta)) if fixed else 0.0
        own_noise = math.sqrt(old_share * old.noise**2 + (1 - old_share) * noise_m**2)
        states = theta, rotation, roots, bone_lengths, residuals, own_noise, stature / model.stature
        solutions.append(TrackSolution(old.model_name, model, *states, std, fit, old.base_poses_lead))
    return solutions


def collect_newest_frames(
    tracks: Sequence[Track],
    parts: Sequence[tuple[int, int]],
    model: PoseModel,
    batch: Batch | None = None,
) -> Batch:
    """Return what `refine` gives to the solver, in the arrays of `batch` if these have its size."""
    counts = [len(track.stamps_ns) - first for track, (first, _) in zip(tracks, parts, strict=True)]
    has_lifted = tracks[0].observed.lifted is not None
    if batch is None or batch.sequences['count'].tolist() != counts or batch.has_lifted != has_lifted:
        batch = Batch(counts, len(model.std), has_lifted)
    pose_fit = prepare_fit(model)
    for p, (track, (_, fixed_frames)) in enumerate(zip(tracks, parts, strict=True)):
        solution, stamps_ns, share = track.solved, track.stamps_ns, 0.0
        if len(solution.theta) > 1:
            steps = (stamps_ns[-1] - stamps_ns[-2]) / max(stamps_ns[-2] - stamps_ns[-3], 1)
            share = EXTRAPOLATION_SHARE * min(steps, MAX_EXTRAPOLATION_STEPS)
        engine.add_newest(batch, p, fixed_frames, share, track.observed, solution, pose_fit)
    return batch
