# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver: its terms and their weights.

    E = reprojection (TPAMI 2016, eq. 9) + bone lengths (eq. 20) + prior of the base poses
      + velocities + accelerations + lifted poses, where there are any

The formulas are in `engine.terms`, and `engine.joint` minimises their sum. With the features x of a frame, the K
weights of the base poses, s R[:2], R[:2] and log s, the velocities are

    mu    sum_tl ((theta_(t+1)l - theta_tl) / sigma_l)^2 / dt_t    smoothness of the weights
  + gamma sum_t |M_(t+1) - M_t|^2 / dt_t                           flip regulariser, M = s R[:2] (TPAMI, eq. 12)
  + tau   sum_t |R_(t+1)[:2] z - R_t[:2] z|^2 / dt_t               tilt: the image of the vertical changes slowly
  + sigma sum_t (log s_(t+1) - log s_t)^2 / dt_t                   scale: people come nearer slowly

and the accelerations those of the weights and of R[:2]. Weights are given for an image noise of 10 mm
(`NOISE_REFERENCE`); under another the reprojection is divided by the ratio of the variances.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.engine import batch as batches
from mocap_ros.engine import joint, terms
from mocap_ros.models.base_poses import MAX_MODELS, PoseModel, arrange_model
from mocap_ros.solvers.joint.batch import Batch, State

NOISE_REFERENCE = 0.01  # m; image noise at the body for which the weights in the configuration are given
MIN_ROBUST_SCALE = 1e-6  # m; a smaller `robust_scale` selects least squares
VERTICAL_FEATURES = (8, 11)  # of the camera: the image of the body's z axis
TYPICAL_OF_POSE = 14.0  # m/s^2; A, over the root of the 15 joints 3.6 m/s^2, that of the joints of a walker
TYPICAL_OF_CAMERA = 4.2  # 1/s^2; A of a body that sways by 4 degrees once a second, and a half more


class Weights(NamedTuple):
    """Weights of the terms under one configuration."""

    prior: Array  # (K,) lambda / sigma_l^2
    # of the features, for the weights (K,) and the camera (13,)
    velocity: tuple[Array, Array]  # mu / sigma_l^2; gamma, tau and sigma
    pose_acceleration: tuple[Array, Array]
    camera_acceleration: tuple[Array, Array]


@lru_cache(maxsize=MAX_MODELS)
def choose_weights(model: PoseModel, config: SolverConfig, has_lifted: bool) -> Weights:
    """Return the weights for base poses, with or without lifted poses."""
    prior, smooth, flip, tilt = config.prior_weight, config.smooth_weight, config.flip_weight, 0.0
    acceleration = config.pose_acceleration_weight
    if model.aligned_by_heading:
        prior, flip = config.heading_prior_factor * prior, config.heading_flip_factor * flip
        tilt = config.tilt_weight
    if has_lifted:
        prior, smooth = config.lifter_prior_factor * prior, config.lifter_smooth_factor * smooth
        flip = config.lifter_flip_factor * flip
        acceleration = config.lifter_acceleration_factor * acceleration
    of_camera = np.repeat([flip, 0.0, config.scale_weight], [6, 6, 1])
    of_camera[list(VERTICAL_FEATURES)] = tilt
    none, directions = np.zeros(len(model.std)), np.repeat([0.0, 1.0, 0.0], [6, 6, 1])
    return Weights(
        prior=prior / model.std**2,
        velocity=(smooth / model.std**2, of_camera),
        pose_acceleration=(np.full(len(model.std), acceleration), np.zeros(13)),
        camera_acceleration=(none, config.camera_acceleration_weight * directions),
    )


def list_terms(
    batch: Batch,
    model: PoseModel,
    config: SolverConfig,
    *,
    components: int | None = None,
    activity: tuple[Array, Array] | None = None,
    has_limits: bool = True,
) -> tuple[terms.Term, ...]:
    """Return the terms of the objective, of the first `components` base poses.

    `activity` are mean square accelerations (N,) m^2/s^4 of poses and (N,) 1/s^4 of cameras; None for rest.
    Without limits no acceleration counts.
    """
    weights, k = choose_weights(model, config, batch.has_lifted), components or len(model.std)

    def join(weight: tuple[Array, Array]) -> Array:
        return np.concatenate([weight[0][:k], weight[1]])

    robust_scale = config.robust_scale if config.robust_scale > MIN_ROBUST_SCALE else np.inf
    out: list[terms.Term] = [
        terms.Reprojection(robust_scale),
        terms.BoneLengths(config.bone_weight, arrange_model(model), k),
        terms.Prior(weights.prior[:k]),
        terms.Velocity(join(weights.velocity)),
    ]
    if has_limits and config.pose_acceleration_weight > 0:
        of_pose, of_camera = activity or (None, None)
        out.append(terms.Acceleration(join(weights.pose_acceleration), TYPICAL_OF_POSE, of_pose))
        out.append(terms.Acceleration(join(weights.camera_acceleration), TYPICAL_OF_CAMERA, of_camera))
    if batch.has_lifted:
        out.append(terms.LiftedPoses(config.lifter_weight, config.lifter_robust_scale))
    return tuple(out)


def pose_problem(
    batch: batches.Batch, model: PoseModel, parts: tuple[terms.Term, ...], components: int | None = None
) -> joint.JointProblem:
    """Return the problem of minimising the sum of terms, of the first `components` base poses."""
    return joint.JointProblem(
        batch, model, arrange_model(model), parts, len(model.std) if components is None else components
    )


def read_state(problem: joint.JointProblem) -> State:
    """Return the unknowns at the current point of a problem."""
    frames = problem.frames
    features = frames['features'][:, : problem.components]
    return State(*(a.copy() for a in (features, frames['rotation'], frames['log_scale'], frames['translation'])))


def set_noise(batch: Batch, noise: Array) -> None:
    """Set the image noise (P,) m under which the objectives of a batch are measured."""
    batch.sequences['noise_ratio'] = noise / NOISE_REFERENCE
