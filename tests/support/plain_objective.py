# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver with NumPy alone: slow, plain, and what the compiled solver is tested against.

The formulas are those at the head of `engine.joint`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import arrange_model
from mocap_ros.solvers.joint.batch import State
from mocap_ros.solvers.joint.differences import FiniteDifference
from mocap_ros.solvers.joint.objective import JointObjective

MIN_DEPTH = 0.1  # of that of the body's origin


class Measured(NamedTuple):
    """What follows from a state."""

    scaled_pose: Array  # (N, J, 3) m, q
    error: Array  # (N, J, 2) m, e
    length: Array  # (N, B) m, l
    direction: Array  # (N, B, 3) unit vectors along the bones, body frame
    mean_length: Array  # (P, B) m, m
    features: Array  # (N, K + 13)


def measure(objective: JointObjective, state: State) -> Measured:
    """Return what the terms of the objective measure in a state."""
    batch, arrays = objective.batch, arrange_model(objective.model)
    poses = objective.model.poses(state.theta)
    scaled = np.exp(state.log_scale)[:, None, None] * (poses @ np.swapaxes(state.rotation, 1, 2))
    depth = np.maximum(1 + scaled[..., 2:] / batch.focal[:, None, None], MIN_DEPTH)
    bones = poses[:, arrays.children] - poses[:, arrays.parents]
    length = np.linalg.norm(bones, axis=-1)
    earlier = batch.earlier_frames[:, None]
    total = np.add.reduceat(length, batch.starts) + earlier * batch.earlier_lengths
    return Measured(
        scaled,
        (scaled[..., :2] + state.translation[:, None]) / depth - batch.image,
        length,
        bones / length[..., None],
        total / (batch.counts[:, None] + earlier),
        measure_features(state),
    )


def measure_features(state: State) -> Array:
    """Return the features (N, K + 13) of all frames."""
    rows = state.rotation[:, :2].reshape(len(state.theta), 6)
    scaled = np.exp(state.log_scale)[:, None] * rows
    return np.concatenate([state.theta, scaled, rows, state.log_scale[:, None]], axis=1)


def take_differences(term: FiniteDifference, features: Array) -> Array:
    """Return the numbers (N - D, F) whose squares are the term, of features (N, F)."""
    count = len(features) - term.order
    parts = [c[:count, None] * features[e : e + count] for e, c in enumerate(term.factors.T)]
    return np.asarray(np.sqrt(term.weight) * np.sum(parts, axis=0))


def compute_costs(objective: JointObjective, state: State) -> dict[str, Array]:
    """Return the value (N,) m^2 of each term in each frame; that of earlier frames is in a window's first."""
    batch, found = objective.batch, measure(objective, state)
    ratio = batch.repeat_per_frame(objective.noise_ratio)[:, None]
    losses = compute_loss((found.error**2).sum(axis=-1), objective.robust_scale * np.maximum(ratio, 1))
    excess = found.length - batch.repeat_per_frame(found.mean_length)
    bones = (objective.bone_weight * excess**2).sum(axis=1)
    change = (objective.bone_weight * (found.mean_length - batch.earlier_lengths) ** 2).sum(axis=1)
    bones[batch.starts] += batch.earlier_frames * change
    costs = {
        'reprojection': (batch.score / ratio**2 * losses).sum(axis=1),
        'bones': bones,
        'prior': state.theta**2 @ objective.prior,
    }
    for i, difference in enumerate(objective.differences):
        squares = (take_differences(difference, found.features) ** 2).sum(axis=1)
        costs[f'difference {i}'] = np.append(squares, np.zeros(len(batch.times) - len(squares)))
    if len(batch.lifted):
        distance = (batch.precision * (found.scaled_pose - batch.lifted) ** 2).sum(axis=-1)
        loss = compute_loss(distance, objective.lifter_robust_scale)
        costs['lifted poses'] = objective.lifter_weight * loss.sum(axis=1)
    return costs


def compute_cost(objective: JointObjective, state: State) -> Array:
    """Return the objective of each sequence, (P,) m^2."""
    per_frame = np.sum(list(compute_costs(objective, state).values()), axis=0)
    return np.asarray(np.add.reduceat(per_frame, objective.batch.starts))


def compute_loss(squared: Array, c: Array | float) -> Array:
    """Return Cauchy's loss rho, or the squares where c is infinite."""
    with np.errstate(invalid='ignore'):
        return np.asarray(np.where(np.isinf(c), squared, np.square(c) * np.log1p(squared / np.square(c))))


def compute_residuals(objective: JointObjective, state: State) -> Array:
    """Return the numbers whose squares are the objective without lifted poses, for least squares."""
    batch, found = objective.batch, measure(objective, state)
    ratio = batch.repeat_per_frame(objective.noise_ratio)[:, None, None]
    parts = [
        np.sqrt(batch.score)[..., None] / ratio * found.error,
        np.sqrt(objective.bone_weight) * (found.length - batch.repeat_per_frame(found.mean_length)),
        np.sqrt(objective.prior) * state.theta,
        *(take_differences(difference, found.features) for difference in objective.differences),
    ]
    return np.concatenate([part.ravel() for part in parts])


def advance(state: State, step: Array) -> State:
    """Return the state after a step (N, K + 4): changes of weights, rotation vectors, and changes of log s."""
    k = state.theta.shape[1]
    return State(
        state.theta + step[:, :k],
        rotation_from_vector(step[:, k : k + 3]) @ state.rotation,
        state.log_scale + step[:, k + 3],
        state.translation,
    )
