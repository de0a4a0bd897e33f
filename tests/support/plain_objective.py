# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The terms of the joint solver with NumPy alone: slow, plain, and what the compiled ones are tested against.

The formulas are those of `engine.terms`. The twin of a term returns weights, numbers whose squares are the cost,
and the scale of the loss of these squares, infinite for least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import terms as engine
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers.joint.batch import Batch, State

MIN_DEPTH = 0.1  # of that of the body's origin


class Measured(NamedTuple):
    """What follows from a state."""

    batch: Batch
    state: State
    joints: Array  # (N, J, 3) m, q
    length: Array  # (N, B) m, l
    noise_ratio: Array  # (N,)


def measure(batch: Batch, model: PoseModel, state: State) -> Measured:
    """Return what the terms of an objective measure in a state."""
    poses = model.mean + np.tensordot(state.theta, model.components[: state.theta.shape[1]], axes=1)
    parents, children = np.transpose(model.skeleton.bones)
    joints = np.exp(state.log_scale)[:, None, None] * (poses @ np.swapaxes(state.rotation, 1, 2))
    length = np.linalg.norm(poses[:, children] - poses[:, parents], axis=-1)
    return Measured(batch, state, joints, length, batch.repeat_per_frame(batch.sequences['noise_ratio']))


def measure_reprojection(term: engine.Reprojection, found: Measured) -> tuple[Array, Array, Array]:
    """Return weights and errors (N, J, 2) m, and the scales (N, 1) of their loss."""
    frames, ratio = found.batch.frames, found.noise_ratio[:, None]
    depth = np.maximum(1 + found.joints[..., 2:] / frames['focal'][:, None, None], MIN_DEPTH)
    error = (found.joints[..., :2] + found.state.translation[:, None]) / depth - frames['image']
    return frames['score'] / ratio**2, error, term.robust_scale * np.maximum(ratio, 1)


def measure_lifted_poses(term: engine.LiftedPoses, found: Measured) -> tuple[Array, Array, float]:
    """Return weights, distances (N, J, 3) in standard deviations, and the scale of their loss."""
    frames = found.batch.frames
    distance = np.sqrt(frames['precision']) * (found.joints - frames['lifted'])
    return np.full(distance.shape[:2], term.weight), distance, term.robust_scale


def measure_bone_lengths(term: engine.BoneLengths, found: Measured) -> tuple[Array, Array, float]:
    """Return lengths less their means, and how far earlier frames are from these, (N + P, B, 1) m."""
    sequences = found.batch.sequences
    earlier, before = sequences['earlier_frames'][:, None], sequences['earlier_lengths']
    total = np.add.reduceat(found.length, sequences['start']) + earlier * before
    mean = total / (sequences['count'][:, None] + earlier)
    excess = found.length - found.batch.repeat_per_frame(mean)
    change = np.concatenate([excess, np.sqrt(earlier) * (mean - before)])
    return np.full(change.shape, term.weight), change[..., None], np.inf


def measure_prior(term: engine.Prior, found: Measured) -> tuple[Array, Array, float]:
    """Return the weights of the base poses, (N, K, 1) m."""
    return np.broadcast_to(term.weight, found.state.theta.shape), found.state.theta[..., None], np.inf


def measure_level(term: engine.Level, found: Measured) -> tuple[Array, Array, float]:
    """Return the components (N, 1, 2) of the vertical that a level camera would not see."""
    vertical = found.state.rotation[:, None, ::2, 2]
    return np.full(vertical.shape[:2], term.weight), vertical, np.inf


def measure_difference(term: engine.FiniteDifference, found: Measured) -> tuple[Array, Array, float]:
    """Return velocities or accelerations of the features, (M, K + 13, 1), times the root of their time."""
    parts = []
    for i, own in enumerate(found.batch.slices):
        times, share = found.batch.times[own], found.batch.sequences['motion_share'][i]
        steps = np.diff(times)[:, None]
        change = np.diff(measure_features(found.state)[own], axis=0) / np.sqrt(steps)
        if isinstance(term, engine.Acceleration):
            between = (steps[1:] + steps[:-1]) / 2
            change = np.diff(change / np.sqrt(steps), axis=0) / np.sqrt(between)
            if term.activity is not None:
                ratio = np.clip(found.batch.sequences['noise_ratio'][i], 1.0, engine.MAX_NOISE_RATIO)
                squares = term.activity[own][:-2, None] / (term.typical * ratio) ** 2
                change /= np.sqrt(1 + squares**2)
        parts.append(np.sqrt(share) * change)
    changes = np.concatenate(parts)
    return np.broadcast_to(term.weight, changes.shape), changes[..., None], np.inf


TWINS: dict[type[engine.Term], Callable[[Any, Measured], tuple[Array, Array, Array | float]]] = {
    engine.Reprojection: measure_reprojection,
    engine.LiftedPoses: measure_lifted_poses,
    engine.BoneLengths: measure_bone_lengths,
    engine.Prior: measure_prior,
    engine.Level: measure_level,
    engine.Velocity: measure_difference,
    engine.Acceleration: measure_difference,
}


def measure_features(state: State) -> Array:
    """Return the features (N, K + 13) of all frames."""
    rows = state.rotation[:, :2].reshape(len(state.theta), 6)
    scaled = np.exp(state.log_scale)[:, None] * rows
    return np.concatenate([state.theta, scaled, rows, state.log_scale[:, None]], axis=1)


def compute_cost(batch: Batch, model: PoseModel, term: engine.Term, state: State) -> float:
    """Return the cost of a term in m^2, of all sequences."""
    weight, errors, c = TWINS[type(term)](term, measure(batch, model, state))
    return float((weight * compute_loss((errors**2).sum(axis=-1), c)).sum())


def compute_loss(squared: Array, c: Array | float) -> Array:
    """Return Cauchy's loss rho, or the squares where c is infinite."""
    with np.errstate(invalid='ignore'):
        return np.asarray(np.where(np.isinf(c), squared, np.square(c) * np.log1p(squared / np.square(c))))


def compute_residuals(batch: Batch, model: PoseModel, terms: Sequence[engine.Term], state: State) -> Array:
    """Return the numbers whose squares are the cost of terms, for least squares."""
    found, parts = measure(batch, model, state), []
    for term in terms:
        weight, errors, _ = TWINS[type(term)](term, found)
        parts.append((np.sqrt(weight)[..., None] * errors).ravel())
    return np.concatenate(parts)


def advance(state: State, step: Array) -> State:
    """Return the state after a step (N, K + 4): changes of weights, rotation vectors, and changes of log s."""
    k = state.theta.shape[1]
    return State(
        state.theta + step[:, :k],
        rotation_from_vector(step[:, k : k + 3]) @ state.rotation,
        state.log_scale + step[:, k + 3],
        state.translation,
    )
