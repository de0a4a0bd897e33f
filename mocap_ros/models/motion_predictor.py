# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Learned prediction of a person's motion by up to a second, from the last 0.8 s.

At the times h_k ahead, the displacement d_0 of the root in the axes S of the line of sight, and those d_j of the
joints about the root in the axes B of the body, come from a network of two hidden layers:

    x = (V^T (q - m), f / 2, ln std, g, S^T B),    x' = (x - x_0) / x_s, within +-4
    (d_1, ..., d_J, d_0)(h_k) = W_2 a(W_1 a(W_0 x' + b_0) + b_1) + b_2,    a(t) = t / (1 + e^-t)

    q     joints about the root in B, their velocities times `VELOCITY_WEIGHT`, and where they were at each of the
          `PAST_S` less where they are; V and m are principal directions and mean
    f     along each axis of S: velocity of the root, where it was at each of the `PAST_S` less where it is,
          velocity and ways of `HEADING_PAST` along the heading, mean velocity of the joints about the root, and
          direction of the heading; upwards a constant instead, and the mean height of the joints over the root
    g     accuracy of the pose, speed of the limbs, speed of the root

S is horizontally away from the camera, to the left and up. The prediction is the mean of those of the person and
of the mirror image. Between the h_k displacements and variances are interpolated; beyond the last, they stay and
deviations grow with time. The errors have variances

    s_a(h_k)^2 = c_0 + c_1 |v|^2 + c_2 l^2 + c_3 p^2
    s_j(h_k)^2 = std_j^2 + e_0 + e_1 |v_j|^2 + e_2 l^2 + e_3 p^2

with |v|, |v_j| and l the speeds of the root, of the joint about it and of the limbs (m/s) and p the mean standard
deviation of the joints; c and e hold 95 of 100 errors of left-out persons (`benchmarks/motion_predictor.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.skeleton import CMU15, find_roots

PAST_S = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)  # s; times ago at which the motion is sampled
HEADING_PAST = [1, 3, 5]  # indices of `PAST_S`; ways along the heading, which change slowly
VELOCITY_WEIGHT = 0.2  # s; of the joints' velocities among the features, which then vary as much as positions
ACCURACY_M = 0.04  # m; the first of the g is 0 for such a mean deviation of the joints; training has hardly better
MAX_SPEED_M_S = 3.0  # m/s; speeds of the g are limited to that of a slow run, of which there is enough in training
MEAN_SPEED_M_S = 0.5  # m/s; speed for which the second and third of the g are 0
STD_RANGE_M = 0.005, 0.5  # m; range of the standard deviations of joints in training, to which they are limited
ROOT_WEIGHT = 0.5  # s; of the features of the root among the inputs, so that they vary about as much as the others
INPUT_LIMIT = 4.0  # standard deviations; there is next to nothing beyond in training
MIRRORED = np.array([1.0, -1.0, 1.0])  # of axes ahead or away, to the left, and up
LEAST_LENGTH = 1e-6  # 1 or m; guards the division by the length of a direction that is nearly vertical


class Past(NamedTuple):
    """What is known of the motions of N people, in m, m/s and the camera's optical frame."""

    joints: Array  # (N, J, 3) at the newest frame, in the order of `skeleton.CMU15`
    velocity: Array  # (N, J, 3) there
    std: Array  # (N, J) m, standard deviations there
    earlier: Array  # (N, 6, J, 3) at each of the `PAST_S` before
    heading: Array  # (N, 3) directions in which the bodies face
    upward: Array  # (N, 3) unit vectors upwards


class Displacements(NamedTuple):
    """Predictions of N people at T times ahead."""

    joints: Array  # (N, T, J, 3) m, by which each joint moves
    # (N, T, J) m, standard deviation of each joint about the root then, with that at the newest frame
    std: Array
    root_covariance: Array  # (N, T, 3, 3) m^2, what the prediction adds to the covariance of the root


class Features(NamedTuple):
    """What the predictions of N people depend on."""

    line_of_sight: Array  # (N, 3, 3) its axes, in columns
    body: Array  # (N, 3, 3) the axes of the body, in columns
    root: Array  # (N, 3, F) of the root, along each axis of the line of sight
    limbs: Array  # (N, D) of the joints about the root
    gates: Array  # (N, 3) the g of the module
    std: Array  # (N, J) m, standard deviations of the joints, limited to `STD_RANGE_M`; `ACCURACY_M` where unknown
    root_squares: Array  # (N, 4) 1 and the squares on which the variances of the root depend
    limb_squares: Array  # (N, J, 4) the same of each joint


@dataclass(frozen=True, eq=False)
class MotionPredictor:
    """A predictor that was trained for K times ahead (formulas of the module); I inputs, H hidden units."""

    times: Array  # (K,) s, the h_k, increasing
    mean: Array  # (D,) m, the m
    directions: Array  # (D, Z) the V
    centre: Array  # (I,) the x_0
    scale: Array  # (I,) the x_s
    weight_0: Array  # (I, H); bias_0 (H,), weight_1 (H, H) and bias_1 (H,) follow
    bias_0: Array
    weight_1: Array
    bias_1: Array
    weight_2: Array  # (H, 3 K (J + 1)), with bias_2 in m; for each time the joints, then the root
    bias_2: Array
    root_variance: Array  # (K, 3, 4) the c
    limb_variance: Array  # (K, J, 4) the e

    def predict(self, past: Past, times: Array) -> Displacements:
        """Return the predictions of N >= 1 people at times (N, T) in s after their newest frames, not negative."""
        features = compute_features(past)
        inputs = np.concatenate([self.build_inputs(features), self.build_inputs(mirror(features))])
        own, mirrored = self._run(inputs).reshape(2, len(times), len(self.times), -1, 3)
        moved = (own + mirrored[:, :, [*CMU15.mirror, -1]] * MIRRORED) / 2
        axes, to_optical = features.line_of_sight, features.body.swapaxes(1, 2)
        joints = moved[:, :, :-1] @ to_optical[:, None] + (moved[:, :, -1] @ axes.swapaxes(1, 2))[:, :, None]
        root_variance = (self.root_variance @ features.root_squares[:, None, :, None])[..., 0]  # (N, K, 3)
        limb_variance = np.einsum('kji,nji->nkj', self.limb_variance, features.limb_squares)
        knots = (0.0, *self.times.tolist())
        weights = [_interpolate(knots, tuple(own)) for own in times.tolist()]
        displaced, varied = (np.array(parts) for parts in zip(*weights, strict=True))  # (N, T, K)
        lengthened = axes[:, None] * (varied @ root_variance)[:, :, None]
        return Displacements(
            (displaced @ joints.reshape(*joints.shape[:2], -1)).reshape(*times.shape, *joints.shape[2:]),
            np.sqrt(past.std[:, None] ** 2 + varied @ limb_variance),
            lengthened @ axes[:, None].swapaxes(2, 3),
        )

    def build_inputs(self, features: Features) -> Array:
        """Return the inputs x' (N, I) of the network."""
        limbs = (features.limbs - self.mean) @ self.directions
        x = np.concatenate([limbs, collect_inputs(features)], axis=1)
        return np.asarray(((x - self.centre) / self.scale).clip(-INPUT_LIMIT, INPUT_LIMIT))

    def _run(self, inputs: Array) -> Array:
        hidden = _activate(inputs @ self.weight_0 + self.bias_0)
        return np.asarray(_activate(hidden @ self.weight_1 + self.bias_1) @ self.weight_2 + self.bias_2)


def collect_inputs(features: Features) -> Array:
    """Return what the network takes besides limbs (N, 69), neither centred nor scaled."""
    turns = features.line_of_sight.swapaxes(1, 2) @ features.body
    parts = ROOT_WEIGHT * features.root, np.log(features.std), features.gates, turns
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def mirror(features: Features) -> Features:
    """Return the features of the mirror image in a vertical plane, left and right called as they then are."""
    count, joints, swapped = len(features.limbs), len(CMU15.joints), list(CMU15.mirror)
    limbs = (features.limbs.reshape(count, -1, joints, 3)[:, :, swapped] * MIRRORED).reshape(count, -1)
    # what is to the left changes its sign in the axes of the line of sight, and so does the left axis of the body
    axes = features.line_of_sight
    body = axes @ (axes.swapaxes(1, 2) @ features.body * MIRRORED[:, None] * MIRRORED)
    return features._replace(
        body=body, root=features.root * MIRRORED[:, None], limbs=limbs, std=features.std[:, swapped]
    )


def _activate(values: Array) -> Array:
    return np.asarray(values / (1 + np.exp(-values)))


@lru_cache(maxsize=100)  # a node asks for the same times again and again, except in gaps
def _interpolate(knots: tuple[float, ...], times: tuple[float, ...]) -> tuple[Array, Array]:
    within = np.minimum(times, knots[-1])
    linear = np.stack([np.interp(within, knots, row) for row in np.eye(len(knots))], axis=1)
    longer = (np.maximum(times, knots[-1]) / knots[-1]) ** 2
    return linear[:, 1:], linear[:, 1:] * longer[:, None]


def compute_features(past: Past) -> Features:
    """Return what the predictions of N people depend on (formulas of the module)."""
    joints, velocity, std, earlier, heading, up = past
    root, root_velocity, earlier_roots = find_roots(joints), find_roots(velocity), find_roots(earlier)
    about, about_velocity = joints - root[:, None], velocity - root_velocity[:, None]
    forward = _make_horizontal(heading, up)
    away = _make_horizontal(root, up)
    body = np.stack([forward, _cross(up, forward), up], axis=2)
    line_of_sight = np.stack([away, _cross(up, away), up], axis=2)
    way = earlier_roots - root[:, None]
    mean_velocity = about_velocity.mean(axis=1)
    own = np.concatenate([root_velocity[:, None], way, mean_velocity[:, None]], axis=1) @ line_of_sight
    ahead = np.concatenate([root_velocity[:, None], -way[:, HEADING_PAST]], axis=1) @ forward[:, :, None]
    facing = forward[:, None] @ line_of_sight  # (N, 1, 3)
    last = np.zeros((len(joints), 2, 3))
    last[:, 0, :2], last[:, 0, 2] = facing[:, 0, :2], 1.0
    last[:, 1, 2] = (about.mean(axis=1) * up).sum(axis=1)
    limbs = np.concatenate(
        [
            about[:, None],
            VELOCITY_WEIGHT * about_velocity[:, None],
            earlier - earlier_roots[:, :, None] - about[:, None],
        ],
        axis=1,
    )
    squared = (about_velocity * about_velocity).sum(axis=2)
    activity, accuracy = squared.mean(axis=1), std.mean(axis=1)
    accuracy[np.isnan(accuracy)] = ACCURACY_M
    speed = np.linalg.norm(way[:, HEADING_PAST[1]], axis=1) / PAST_S[HEADING_PAST[1]]
    gates = np.stack(
        [
            ACCURACY_M / np.maximum(accuracy, ACCURACY_M) - 1,
            np.minimum(np.sqrt(activity), MAX_SPEED_M_S) - MEAN_SPEED_M_S,
            np.minimum(speed, MAX_SPEED_M_S) - MEAN_SPEED_M_S,
        ],
        axis=1,
    )
    root_squares = np.stack([np.ones(len(joints)), speed**2, activity, accuracy**2], axis=1)
    limb_squares = np.repeat(root_squares[:, None], squared.shape[1], axis=1)
    limb_squares[:, :, 1] = squared
    return Features(
        line_of_sight,
        body,
        np.concatenate([own, ahead * facing, last], axis=1).swapaxes(1, 2),
        (limbs @ body[:, None]).reshape(len(joints), -1),
        gates,
        np.where(np.isnan(std), ACCURACY_M, std).clip(*STD_RANGE_M),
        root_squares,
        limb_squares,
    )


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (N, 3); `numpy.cross` takes five times as long for a few."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _make_horizontal(direction: Array, up: Array) -> Array:
    """Return the horizontal unit vectors (N, 3) nearest to directions, or any of vertical ones."""
    flat = direction - (direction * up).sum(axis=1, keepdims=True) * up
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    if (length < LEAST_LENGTH).any():
        other = _cross(up, np.eye(3)[np.argmin(np.abs(up), axis=1)])
        flat = np.where(length < LEAST_LENGTH, other, flat)
        length = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.asarray(flat / length)
