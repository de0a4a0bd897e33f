# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A synthetic walk with known weights and cameras, and the error of its reconstruction."""

import numpy as np

from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import Array, Reconstruction, Window

# Weights (F, K) m, cameras, points (F, J, 2) px and times (F,) s of a motion.
Walk = tuple[Array, WeakPerspectiveCameras, Array, Array]

# Rotation from the body frame (x forward, z up) to the optical frame of a camera that looks along x.
BODY_TO_OPTICAL = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])


def make_walk(model: BasePoses, frames: int = 40, k: int = 4, seed: int = 0) -> Walk:
    """Return weights (F, K) m, cameras, points (F, J, 2) px and times (F,) s of a motion."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / 30
    phase = rng.uniform(0, 6, k)
    theta = np.zeros((frames, len(model.std)))
    theta[:, :k] = model.std[:k] * np.sin(6 * times[:, None] + phase)
    heading = 0.8 + 0.3 * times
    rotation = BODY_TO_OPTICAL @ rotation_from_vector(heading[:, None] * [0, 0, 1])
    cameras = WeakPerspectiveCameras(200 + 10 * times, rotation)
    points = cameras.project(model.poses(theta)) + [320, 240]
    return theta, cameras, points, times


def compute_mpjpe(
    result: Reconstruction, model: BasePoses, theta: Array, cameras: WeakPerspectiveCameras
) -> float:
    """Return the mean joint error (mm) after one scale for the sequence."""
    truth = model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2)
    p = result.joints
    p = p * ((p * truth).sum() / (p * p).sum())
    return float(np.linalg.norm(p - truth, axis=-1).mean() * 1e3)


def make_noisy_window(model: BasePoses, seed: int, missing: float) -> Window:
    """Twelve frames of a walk with 5 px of noise, random scores, and a share of the points missing."""
    _, _, points, times = make_walk(model, frames=12, seed=seed)
    rng = np.random.default_rng(seed)
    points = points + 5 * rng.normal(size=points.shape)
    weight = rng.uniform(0.1, 1, points.shape[:2]) * (rng.random(points.shape[:2]) >= missing)
    return Window(points, weight, times)
