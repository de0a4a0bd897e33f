# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver: its terms and their weights.

    E = reprojection (TPAMI 2016, eq. 9) + bone lengths (eq. 20) + prior of the base poses
      + differences (`differences`) + lifted poses, where there are any

The formulas are in `engine.joint`, which minimises it. Weights are given for an image noise of
10 mm (`NOISE_REFERENCE`); under another the reprojection is divided by the ratio of the variances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint as engine
from mocap_ros.models.base_poses import MAX_MODELS, BasePoses, arrange_model
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.joint.differences import (
    CAMERA_FEATURES,
    MIN_TIME_STEP_S,
    TYPICAL_OF_CAMERA,
    TYPICAL_OF_POSE,
    VERTICAL_FEATURES,
    FiniteDifference,
    invert_time_steps,
    limit_acceleration,
    measure_activity,
    weigh_velocity_change,
)

NOISE_REFERENCE = 0.01  # m; image noise at the body for which the weights in the configuration are given
LASTING_S = 1 / 30  # s; frames that are nearer have the same errors, for which weights were tuned at this rate
MIN_ROBUST_SCALE = 1e-6  # m; a smaller `robust_scale` selects least squares


class Weights(NamedTuple):
    """Weights of the terms under one configuration."""

    prior: Array  # (K,) lambda / sigma_l^2
    of_bones: Array  # (B,) beta
    of_velocity: Array  # (K + 13,) of the features in differences of order 1: mu / sigma_l^2, gamma, tau and sigma
    of_pose: Array  # (K + 13,) 1 for the weights of the base poses
    of_direction: Array  # (K + 13,) 1 for the elements of R[:2]


@lru_cache(maxsize=MAX_MODELS)
def choose_weights(model: BasePoses, config: SolverConfig, has_lifted: bool) -> Weights:
    """Return the weights for base poses, with or without lifted poses."""
    prior, smooth, flip, tilt = config.prior_weight, config.smooth_weight, config.flip_weight, 0.0
    if model.aligned_by_heading:
        prior, flip = config.heading_prior_factor * prior, config.heading_flip_factor * flip
        tilt = config.tilt_weight
    if has_lifted:
        prior, smooth = config.lifter_prior_factor * prior, config.lifter_smooth_factor * smooth
        flip = config.lifter_flip_factor * flip
    of_camera = np.repeat([flip, 0.0, config.scale_weight], [6, 6, 1])
    of_camera[list(VERTICAL_FEATURES)] = tilt
    k, directions = len(model.std), np.repeat([0.0, 1.0, 0.0], [6, 6, 1])
    return Weights(
        prior=prior / model.std**2,
        of_bones=np.full(len(model.skeleton.bones), config.bone_weight),
        of_velocity=np.concatenate([smooth / model.std**2, of_camera]),
        of_pose=np.repeat([1.0, 0.0], [k, CAMERA_FEATURES]),
        of_direction=np.concatenate([np.zeros(k), directions]),
    )


@dataclass(frozen=True, eq=False)
class JointObjective:
    """The objective of a batch of sequences."""

    batch: Batch
    model: BasePoses
    noise_ratio: Array  # (P,) image noise over that of the reference
    # m, c of the reprojection under the reference noise; infinite for least squares. It grows with noise above the
    # reference
    robust_scale: float
    bone_weight: Array  # (B,) beta of each bone
    prior: Array  # (K,) lambda / sigma_l^2, of the first K base poses of the model
    lifter_weight: float  # m^2, omega
    lifter_robust_scale: float
    differences: tuple[FiniteDifference, ...]

    @staticmethod
    def build(
        batch: Batch,
        model: BasePoses,
        config: SolverConfig,
        noise: Array | None = None,
        share: Array | None = None,
        activity: tuple[Array, Array] | None = None,
    ) -> JointObjective:
        """Return the objective with the weights of the configuration, at a noise (P,) m, None for the reference.

        Differences of a selection count by a `share` (P,), and there are none of order 2; else by `weigh_motion`.
        `activity` are mean square accelerations (N,) m^2/s^4 of poses and (N,) 1/s^4 of cameras; None for rest.
        """
        weights = choose_weights(model, config, len(batch.lifted) > 0)
        noise_ratio = np.ones(len(batch.starts)) if noise is None else noise / NOISE_REFERENCE
        inverse = invert_time_steps(batch)
        share_of_frame = batch.repeat_per_frame(weigh_motion(batch) if share is None else share)
        root = np.sqrt(share_of_frame * inverse)
        differences = [FiniteDifference(np.stack([-root, root], axis=1), weights.of_velocity)]
        if share is None and config.pose_acceleration_weight > 0:
            change = np.sqrt(share_of_frame)[:, None] * weigh_velocity_change(batch)
            ratio = batch.repeat_per_frame(noise_ratio)
            of_pose, of_camera = activity or (np.zeros(len(ratio)), np.zeros(len(ratio)))
            alpha, kappa = config.pose_acceleration_weight, config.camera_acceleration_weight
            pose = limit_acceleration(alpha, TYPICAL_OF_POSE, change, of_pose, ratio)
            camera = limit_acceleration(kappa, TYPICAL_OF_CAMERA, change, of_camera, ratio)
            differences.append(FiniteDifference(pose, weights.of_pose))
            differences.append(FiniteDifference(camera, weights.of_direction))
        return JointObjective(
            batch=batch,
            model=model,
            noise_ratio=noise_ratio,
            robust_scale=config.robust_scale if config.robust_scale > MIN_ROBUST_SCALE else np.inf,
            bone_weight=weights.of_bones,
            prior=weights.prior,
            lifter_weight=config.lifter_weight,
            lifter_robust_scale=config.lifter_robust_scale,
            differences=tuple(differences),
        )

    @property
    def factors(self) -> Array:
        """The factors (T, N, 3) of all differences, 0 behind those of order 1."""
        factors = np.zeros((len(self.differences), len(self.batch.times), 3))
        for own, difference in zip(factors, self.differences, strict=True):
            own[:, : difference.order + 1] = difference.factors
        return factors

    def truncate(self, k: int) -> JointObjective:
        """Return the objective of the first `k` base poses."""
        weights = [np.concatenate([d.weight[:k], d.weight[-CAMERA_FEATURES:]]) for d in self.differences]
        differences = tuple(replace(d, weight=w) for d, w in zip(self.differences, weights, strict=True))
        return replace(self, prior=self.prior[:k], differences=differences)

    def with_noise(self, noise: Array) -> JointObjective:
        """Return the objective under image noise (P,) m, with the same limits to accelerations."""
        return replace(self, noise_ratio=noise / NOISE_REFERENCE)

    def compile(
        self, state: State | None = None, settle_steps: int = 0, *, at_reference: bool = False
    ) -> engine.JointProblem:
        """Return the objective as a problem of the compiled solver.

        Translations first settle by some steps of the robust fit, `at_reference` under the scale of the reference
        noise.
        """
        problem = engine.JointProblem(self, arrange_model(self.model))
        if state is not None:
            problem.start(*state, settle_steps, at_reference)
        return problem


def read_state(problem: engine.JointProblem) -> State:
    """Return the unknowns at the current point of a problem."""
    return State(*(problem.read(name) for name in State._fields))


def weigh_motion(batch: Batch) -> Array:
    """Return the weights (P,) of differences: as errors of a detector last, more frames a second say no more."""
    spans = batch.times[batch.starts + batch.counts - 1] - batch.times[batch.starts]
    return np.asarray(np.maximum(LASTING_S * (batch.counts - 1) / np.maximum(spans, MIN_TIME_STEP_S), 1.0))


def measure_activities(state: State, coarse: Batch, batch: Batch) -> tuple[Array, Array]:
    """Return the mean square accelerations (N,) of poses and cameras about each frame, from a state of some."""
    directions = state.rotation[:, :2].reshape(len(state.theta), 6)
    return measure_activity(state.theta, coarse, batch), measure_activity(directions, coarse, batch)
