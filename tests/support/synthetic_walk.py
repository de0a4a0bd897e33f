"""A synthetic walk with known weights and cameras, and the error of what was reconstructed from it."""

from __future__ import annotations

import numpy as np

from mocap_ros.geometry.rotations import small_rotation
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import Reconstruction

OPTICAL = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])  # body x forward, z up -> looking along x


def scene(model: BasePoses, frames: int = 40, k: int = 4, seed: int = 0):
    """Weights, cameras, projected points (px) and times of a smooth motion under a turning camera."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / 30
    phase = rng.uniform(0, 6, k)
    theta = np.zeros((frames, len(model.std)))
    theta[:, :k] = model.std[:k] * np.sin(6 * times[:, None] + phase)
    heading = 0.8 + 0.3 * times
    rotation = OPTICAL @ small_rotation(heading[:, None] * [0, 0, 1])
    cameras = Cameras(200 + 10 * times, rotation)
    points = cameras.project(model.poses(theta)) + [320, 240]
    return theta, cameras, points, times


def mpjpe(result: Reconstruction, model: BasePoses, theta, cameras) -> float:
    truth = model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2)
    p = result.joints
    p = p * ((p * truth).sum() / (p * p).sum())
    return float(np.linalg.norm(p - truth, axis=-1).mean() * 1e3)
