# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A synthetic walk with known weights and cameras, and the error of its reconstruction."""

from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.evaluation.metrics import scale_to_reference
from mocap_ros.geometry.rotations import centre_poses, rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import Window

# Rotation from the body frame (x forward, z up) to the optical frame of a camera that looks along x.
BODY_TO_OPTICAL = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])


class Walk(NamedTuple):
    """Weights (F, K) m, cameras, points (F, J, 2) px and times (F,) s of a motion."""

    theta: Array
    cameras: WeakPerspectiveCameras
    points: Array
    times: Array

    @property
    def window(self) -> Window:
        return Window(self.points, np.ones(self.points.shape[:2]), self.times)

    def poses(self, model: BasePoses) -> Array:
        """Return the joints (F, J, 3) m about the body's origin, along the axes of the camera."""
        return model.poses(self.theta) @ np.swapaxes(self.cameras.rotation, -1, -2)


def make_walk(model: BasePoses, frames: int = 40, k: int = 4, seed: int = 0) -> Walk:
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / 30
    phase = rng.uniform(0, 6, k)
    theta = np.zeros((frames, len(model.std)))
    theta[:, :k] = model.std[:k] * np.sin(6 * times[:, None] + phase)
    heading = 0.8 + 0.3 * times
    rotation = BODY_TO_OPTICAL @ rotation_from_vector(heading[:, None] * [0, 0, 1])
    cameras = WeakPerspectiveCameras(200 + 10 * times, rotation)
    return Walk(theta, cameras, cameras.project(model.poses(theta)) + [320, 240], times)


def mpjpe_mm(found: Array, truth: Array) -> float:
    """Return the mean error of joints (F, J, 3) about their centroids, after one scale for the sequence."""
    found, truth = centre_poses(found), centre_poses(truth)
    return float(np.linalg.norm(scale_to_reference(found, truth) - truth, axis=-1).mean() * 1e3)


def with_scores(points: Array, score: float = 1.0) -> Array:
    """Return keypoints (F, J, 3) of points (F, J, 2) px that all have one score."""
    return np.concatenate([points, np.full((*points.shape[:2], 1), score)], axis=-1)
