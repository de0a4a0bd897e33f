# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver: its terms and their weights.

    E = reprojection (TPAMI 2016, eq. 9) + bone lengths (eq. 20) + prior of the base poses
      + differences (`differences`) + lifted poses, where there are any

The formulas are in `engine.joint`, which minimises it, and in `reference`, which computes it with NumPy alone. All
weights but that of the first term are given for an image noise of 10 mm (`NOISE_REFERENCE`). Under another noise
the reprojection is divided by the ratio of the variances, as the maximum of the posterior demands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.engine import joint as engine
from mocap_ros.models.base_poses import BasePoses, arrange_model
from mocap_ros.solvers.joint.batch import Batch, State
from mocap_ros.solvers.joint.differences import (
    CAMERA_FEATURES,
    LOG_SCALE_FEATURE,
    TYPICAL_OF_CAMERA,
    TYPICAL_OF_POSE,
    VERTICAL_FEATURES,
    FiniteDifference,
    invert_time_steps,
    limit_acceleration,
    measure_activity,
    weigh_features,
    weigh_velocity_change,
)

Array = NDArray[np.float64]

NOISE_REFERENCE = 0.01  # m; image noise at the body for which the weights in the configuration are given
MIN_ROBUST_SCALE = 1e-6  # m; a smaller `robust_scale` selects least squares


@dataclass(frozen=True, eq=False)
class JointObjective:
    """The objective of a batch of sequences.

    Attributes:
        batch: the measurements.
        model: base poses, metric.
        noise_ratio: (P,) image noise over that of the reference.
        robust_scale: m, c of the reprojection under the reference noise; infinite for least squares. It grows with
            noise above the reference.
        bone_weight: (B,) beta of each bone.
        prior: (K,) lambda / sigma_l^2, of the first K base poses of the model.
        lifter_weight: m^2, omega.
        lifter_robust_scale: standard deviations, c of the lifted poses.
        differences: the smoothness of poses and cameras.
    """

    batch: Batch
    model: BasePoses
    noise_ratio: Array
    robust_scale: float
    bone_weight: Array
    prior: Array
    lifter_weight: float
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
        """Return the objective with the weights of the configuration.

        Args:
            batch: the measurements.
            model: base poses.
            config: weights of the terms.
            noise: (P,) m, standard deviation of a coordinate of a point of weight 1; None for the reference.
            share: (P,) of the frames of each sequence that are in the batch, where it is a selection; its
                differences keep their balance with the image, and there are none of order 2.
            activity: (N,) m^2/s^4 and (N,) 1/s^4, mean square accelerations of poses and cameras; None for rest.
        """
        prior, smooth, flip, tilt = config.prior_weight, config.smooth_weight, config.flip_weight, 0.0
        if model.aligned_by_heading:
            prior, flip = config.heading_prior_factor * prior, config.heading_flip_factor * flip
            tilt = config.tilt_weight
        if len(batch.lifted):
            prior, smooth = config.lifter_prior_factor * prior, config.lifter_smooth_factor * smooth
            flip = config.lifter_flip_factor * flip
        noise_ratio = np.ones(len(batch.starts)) if noise is None else noise / NOISE_REFERENCE
        inverse = invert_time_steps(batch)
        root = np.sqrt(inverse if share is None else batch.repeat_per_frame(share) * inverse)
        weight = weigh_features(smooth / model.std**2, matrix=flip)
        for feature in VERTICAL_FEATURES:
            weight[len(model.std) + feature] = tilt
        weight[len(model.std) + LOG_SCALE_FEATURE] = config.scale_weight
        differences = [FiniteDifference(np.stack([-root, root], axis=1), weight)]
        if share is None and config.pose_acceleration_weight > 0:
            change, ratio = weigh_velocity_change(batch), batch.repeat_per_frame(noise_ratio)
            none = np.zeros(len(model.std))
            for alpha, typical, mean_square, features in (
                (config.pose_acceleration_weight, TYPICAL_OF_POSE, 0, weigh_features(none + 1)),
                (config.camera_acceleration_weight, TYPICAL_OF_CAMERA, 1, weigh_features(none, direction=1.0)),
            ):
                square = np.zeros(len(ratio)) if activity is None else activity[mean_square]
                factors = limit_acceleration(alpha, typical, change, square, ratio)
                differences.append(FiniteDifference(factors, features))
        return JointObjective(
            batch=batch,
            model=model,
            noise_ratio=noise_ratio,
            robust_scale=config.robust_scale if config.robust_scale > MIN_ROBUST_SCALE else np.inf,
            bone_weight=np.full(len(model.skeleton.bones), config.bone_weight),
            prior=prior / model.std**2,
            lifter_weight=config.lifter_weight,
            lifter_robust_scale=config.lifter_robust_scale,
            differences=tuple(differences),
        )

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

        Args:
            state: where it starts; None to set that later.
            settle_steps: number of steps of the robust fit by which the translations settle first.
            at_reference: whether they settle under the robust scale of the reference noise.
        """
        batch, arrays, k = self.batch, arrange_model(self.model), len(self.prior)
        factors = np.zeros((len(self.differences), len(batch.times), 3))
        for own, difference in zip(factors, self.differences, strict=True):
            own[:, : difference.order + 1] = difference.factors
        problem = engine.JointProblem(
            starts=batch.starts,
            counts=batch.counts,
            is_free=batch.is_free,
            image=batch.image,
            score=np.ascontiguousarray(batch.score),
            focal=batch.focal,
            lifted=batch.lifted,
            precision=batch.precision,
            earlier_lengths=batch.earlier_lengths,
            earlier_frames=batch.earlier_frames,
            noise_ratio=self.noise_ratio,
            mean=self.model.mean,
            basis=np.ascontiguousarray(arrays.components[:, :k]),
            bones=np.ascontiguousarray(arrays.bones[:, :k]),
            parents=arrays.parents,
            children=arrays.children,
            robust_scale=self.robust_scale,
            bone_weight=self.bone_weight,
            prior=self.prior,
            lifter_weight=self.lifter_weight,
            lifter_robust_scale=self.lifter_robust_scale,
            orders=np.array([d.order for d in self.differences], np.int64),
            factors=factors,
            feature_weight=np.array([d.weight for d in self.differences]).reshape(-1, k + CAMERA_FEATURES),
        )
        if state is not None:
            problem.start(*state, settle_steps, at_reference)
        return problem


def read_state(problem: engine.JointProblem) -> State:
    """Return the unknowns at the current point of a problem."""
    return State(*(problem.read(name) for name in State._fields))


def measure_activities(state: State, coarse: Batch, batch: Batch) -> tuple[Array, Array]:
    """Return the mean square accelerations (N,) of poses and cameras about each frame of a batch.

    Args:
        state: of some of the frames.
        coarse: these frames.
        batch: all frames; the same sequences.
    """
    directions = state.rotation[:, :2].reshape(len(state.theta), 6)
    return measure_activity(state.theta, coarse, batch), measure_activity(directions, coarse, batch)
