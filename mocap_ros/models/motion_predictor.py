"""Learned prediction of a person's motion by up to a second, from the last 0.8 s.

At the times h_k ahead, the displacement of the root along each axis a of the line of sight, and that of the joints
about the root in the axes of the body, are linear:

    d_a(h_k) = w_ak . (f_a (1, g)),    d(h_k) = R W_k ((z, z g_2)),    z = V^T (x - m)

    f_a   velocity of the root along the axis, the ways that it has come within each of the `PAST_S`, both also
          along the heading, mean velocity of the joints about the root, and the direction of the heading; upwards
          the height of the joints over the root and a constant instead
    x     joints about the root in the axes of the body (forward, left, up), their velocities, and how they have
          changed since each of the `PAST_S`
    g     what tells signal from tremble: accuracy of the pose, speed of the limbs, speed of the root

The axes of the line of sight are horizontally away from the camera, to the left and up: depth trembles most, so a
velocity along it counts less. Between the h_k, and from 0 on, displacements and variances are interpolated; beyond
the last, displacements stay and deviations grow with time. The errors of the prediction have variances

    s_a(h_k)^2 = c_0 + c_1 |v|^2 + c_2 l^2 + c_3 p^2
    s_j(h_k)^2 = std_j^2 + e_0 + e_1 |v_j|^2 + e_2 l^2 + e_3 p^2

with |v| the speed of the root, |v_j| that of the joint about the root, l that of the limbs (all in m/s) and p the
mean standard deviation of the joints. The c and e are fitted to squared errors, and multiplied so that 95 of 100
errors are within the ellipsoids of that probability (`benchmarks/experiments/motion_predictor.py`, which
trains all).
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.people import HIPS

Array = NDArray[np.float64]

PAST_S = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)  # s; times ago at which the motion is sampled
HEADING_PAST = (1, 3, 5)  # of `PAST_S`: ways along the heading, which change slowly
PREDICTOR_NAME = 'predictor'  # name of the shipped file among the models
ARRAYS = ('times', 'root', 'mean', 'directions', 'limbs', 'root_variance', 'limb_variance')  # of the file
VELOCITY_WEIGHT = 0.2  # s; of the joints' velocities among the features, so that they vary about as much as places
ACCURACY_M = 0.04  # m; the first of the g is 0 for such a mean deviation of the joints; training has hardly better
MAX_SPEED_M_S = 3.0  # m/s; speeds of the g are limited to that of a slow run, of which there is enough in training
MEAN_SPEED_M_S = 0.5  # m/s; speed for which the second and third of the g are 0
LEAST_LENGTH = 1e-6  # 1; of a direction that is normalised


class Past(NamedTuple):
    """What is known of a person's motion, in m, m/s and the camera's optical frame.

    Attributes:
        joints: (J, 3) at the newest frame, in the order of `skeleton.CMU15`.
        velocity: (J, 3) there.
        std: (J,) m, standard deviations there.
        earlier: (6, J, 3) at each of the `PAST_S` before.
        heading: (3,) direction in which the body faces.
        upward: (3,) unit vector upwards.
    """

    joints: Array
    velocity: Array
    std: Array
    earlier: Array
    heading: Array
    upward: Array


class Displacements(NamedTuple):
    """Prediction of a person at N times ahead.

    Attributes:
        joints: (N, J, 3) m, by which each joint moves.
        std: (N, J) m, standard deviation of each joint about the root then, that at the newest frame included.
        root_covariance: (N, 3, 3) m^2, what the prediction adds to the covariance of the root.
    """

    joints: Array
    std: Array
    root_covariance: Array


class Features(NamedTuple):
    """What a prediction is linear in.

    Attributes:
        line_of_sight: (3, 3) its axes, in columns.
        body: (3, 3) the axes of the body, in columns.
        root: (3, F) of the root, along each axis of the line of sight.
        limbs: (D,) of the joints about the root.
        gates: (3,) the g of the module.
        root_squares: (4,) 1 and the squares on which the variances of the root depend.
        limb_squares: (J, 4) the same of each joint.
    """

    line_of_sight: Array
    body: Array
    root: Array
    limbs: Array
    gates: Array
    root_squares: Array
    limb_squares: Array


@dataclass(frozen=True, eq=False)
class MotionPredictor:
    """A predictor that was trained for K times ahead (formulas of the module).

    Attributes:
        times: (K,) s, the h_k, increasing.
        root: (K, 3, 4 F) the w.
        mean: (D,) m.
        directions: (D, Z) the V.
        limbs: (K, 2 Z, 3 J) the W.
        root_variance: (K, 3, 4) the c.
        limb_variance: (K, J, 4) the e.
    """

    times: Array
    root: Array
    mean: Array
    directions: Array
    limbs: Array
    root_variance: Array
    limb_variance: Array

    def predict(self, past: Past, times: Array) -> Displacements:
        """Return the prediction at times (N,) in s after the newest frame, not negative."""
        features = compute_features(past)
        gated = np.concatenate([features.root, *(g * features.root for g in features.gates.tolist())], axis=1)
        root = (self.root * gated).sum(axis=2) @ features.line_of_sight.T
        z = (features.limbs - self.mean) @ self.directions
        limbs = np.concatenate([z, features.gates[1] * z]) @ self.limbs
        joints = root[:, None] + limbs.reshape(len(root), -1, 3) @ features.body.T
        root_variance = self.root_variance @ features.root_squares
        limb_variance = (self.limb_variance * features.limb_squares).sum(axis=2)
        displaced, varied = _interpolate((0.0, *self.times.tolist()), tuple(times.tolist()))
        axes = features.line_of_sight
        return Displacements(
            np.tensordot(displaced, joints, 1),
            np.sqrt(past.std**2 + varied @ limb_variance),
            (axes * (varied @ root_variance)[:, None]) @ axes.T,
        )


@lru_cache(maxsize=100)  # a node asks for the same times again and again, except in gaps
def _interpolate(knots: tuple[float, ...], times: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the weights (N, K) of the displacements and of the variances at K times for N other times.

    Args:
        knots: s, 0 and the K times.
        times: s, the other times.
    """
    within = np.minimum(times, knots[-1])
    linear = np.stack([np.interp(within, knots, row) for row in np.eye(len(knots))], axis=1)
    longer = (np.maximum(times, knots[-1]) / knots[-1]) ** 2
    return linear[:, 1:], linear[:, 1:] * longer[:, None]


def compute_features(past: Past) -> Features:
    """Return what the prediction of a person is linear in (formulas of the module)."""
    joints, velocity, std, earlier, heading, up = past
    root, root_velocity = _centre(joints), _centre(velocity)
    earlier_roots = (earlier[:, HIPS[0]] + earlier[:, HIPS[1]]) / 2
    about, about_velocity = joints - root, velocity - root_velocity
    forward = _make_horizontal(heading, up)
    away = _make_horizontal(root, up)
    body = np.stack([forward, np.cross(up, forward), up], axis=1)
    line_of_sight = np.stack([away, np.cross(up, away), up], axis=1)
    way = earlier_roots - root
    mean_velocity = about_velocity.mean(axis=0)
    own = np.concatenate([[root_velocity], way, [mean_velocity]]) @ line_of_sight  # (8, 3)
    ahead = np.concatenate([[root_velocity @ forward], -(way[list(HEADING_PAST)] @ forward)])
    facing = forward @ line_of_sight
    along = ahead[:, None] * facing
    last = np.array([[facing[0], facing[1], 1.0], [0.0, 0.0, about.mean(axis=0) @ up]])
    limbs = np.concatenate(
        [
            about[None],
            VELOCITY_WEIGHT * about_velocity[None],
            earlier - earlier_roots[:, None] - about,
        ]
    )
    squared = (about_velocity * about_velocity).sum(axis=1)
    activity, accuracy = float(squared.mean()), float(np.nan_to_num(std.mean(), nan=ACCURACY_M))
    speed = float(np.linalg.norm(way[HEADING_PAST[1]])) / PAST_S[HEADING_PAST[1]]
    gates = np.array(
        [
            ACCURACY_M / max(accuracy, ACCURACY_M) - 1,
            min(activity**0.5, MAX_SPEED_M_S) - MEAN_SPEED_M_S,
            min(speed, MAX_SPEED_M_S) - MEAN_SPEED_M_S,
        ]
    )
    shared = np.array([activity, accuracy**2])
    count = len(squared)
    return Features(
        line_of_sight,
        body,
        np.concatenate([own, along, last]).T,
        (limbs @ body).ravel(),
        gates,
        np.array([1.0, speed**2, *shared]),
        np.stack([np.ones(count), squared, *np.repeat(shared[:, None], count, axis=1)], axis=1),
    )


def _centre(places: Array) -> Array:
    """Return the middle (3,) between the hips of places or velocities (J, 3)."""
    return np.asarray((places[HIPS[0]] + places[HIPS[1]]) / 2)


def _make_horizontal(direction: Array, up: Array) -> Array:
    """Return the horizontal unit vector (3,) nearest to a direction, or any of a vertical one."""
    flat = direction - (direction @ up) * up
    length = np.linalg.norm(flat)
    if length < LEAST_LENGTH:
        flat = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        length = np.linalg.norm(flat)
    return np.asarray(flat / length)


@cache
def load_motion_predictor() -> MotionPredictor:
    """Return the shipped predictor."""
    data = (files('mocap_ros') / 'models' / 'shipped' / f'{PREDICTOR_NAME}.npz').read_bytes()
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name].astype(np.float64) for name in ARRAYS}
    return MotionPredictor(**arrays)
