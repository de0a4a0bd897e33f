# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Virtual cameras that face a person: weak perspective is near to a real camera only along the optical axis.

    R = I + [v]x + [v]x^2 / (1 + c),    v = u x e,    c = u . e        rotation from the real to the virtual camera
    X = R^T (t_x, t_y, f) / s                                          the body's origin in the real camera, m

u is the unit vector to the person, e = (0, 0, 1), f the focal length (px), s the scale (px/m) and t the image
point of the origin (px). Solvers work in the image of a virtual camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras

MIN_TOTAL_WEIGHT = 1e-12  # 1; guards the division by the sum of confidence scores in frames without seen joints
MIN_FRAME_WEIGHT = 1e-12  # 1; lets distant frames define the direction where no near frame has a seen joint
MIN_DIVISOR = 1e-300  # 1; guards the division when no frame at all has a seen joint
MIN_DEPTH_M = 1e-3  # m; guards the division by the depth of the body's origin
SMOOTHING_REACH_STD = 10.0  # standard deviations; frames farther away would weigh less than 1e-21
FRAMES_PER_BLOCK = 1024  # frames averaged at once; bounds the memory, which grows with its square


@dataclass(eq=False)
class VirtualCamera:
    """Virtual cameras that face one person: one for each frame, or one for all frames."""

    rotation: Array  # (F, 3, 3) or (3, 3) rotation from the real camera's optical frame to the virtual camera's
    # intrinsics of the real camera. The virtual cameras have the same focal length, no distortion, and image
    # points relative to their optical axes
    intrinsics: Intrinsics

    @staticmethod
    def look_at_person(
        rays: Array, weight: Array, times: Array, smoothing_s: float, intrinsics: Intrinsics
    ) -> VirtualCamera:
        """Return virtual cameras that look at the weighted centroid of the seen joints, averaged over time.

        The weights are a Gaussian, `smoothing_s` s two standard deviations. Rays (F, J, 2) are always finite.
        """
        total = weight.sum(axis=1)
        centroid = (weight[..., None] * rays).sum(axis=1) / np.maximum(total, MIN_TOTAL_WEIGHT)[:, None]
        seen = np.concatenate([centroid, np.ones_like(centroid[:, :1])], axis=-1) * (total > 0)[:, None]
        std_s = smoothing_s / 2
        sums = np.empty_like(seen)
        for start in range(0, len(times), FRAMES_PER_BLOCK):
            block = slice(start, start + FRAMES_PER_BLOCK)
            reach_s = SMOOTHING_REACH_STD * std_s * np.array([-1.0, 1.0])
            near = slice(*np.searchsorted(times, times[block][[0, -1]] + reach_s).tolist())
            sums[block] = np.exp(-0.5 * ((times[block, None] - times[near]) / std_s) ** 2) @ seen[near]
        sums += MIN_FRAME_WEIGHT * seen.sum(axis=0)
        direction = sums[:, :2] / np.maximum(sums[:, 2:], MIN_DIVISOR)
        return VirtualCamera(rotation_to_optical_axis(direction), intrinsics)

    @staticmethod
    def look_at_mean_position(rays: Array, weight: Array, intrinsics: Intrinsics) -> VirtualCamera:
        """Return one virtual camera for all frames, which looks at the weighted centroid of their seen joints."""
        return VirtualCamera(engine.face_points(rays, weight, MIN_TOTAL_WEIGHT), intrinsics)

    def select_frames(self, frames: NDArray[np.intp] | slice) -> VirtualCamera:
        """Return the virtual cameras of the given frames."""
        return self if self.rotation.ndim == 2 else VirtualCamera(self.rotation[frames], self.intrinsics)

    def view_rays(self, rays: Array, weight: Array, focal: float) -> Array:
        """Return the image points (F, J, 2) of rays, in the unit of `focal`; 0 where the weight (F, J) is 0."""
        rotations = self.rotation.reshape(-1, 3, 3)
        return engine.view_rays(np.ascontiguousarray(rays), np.ascontiguousarray(weight), rotations, focal)

    def root_positions(self, cameras: WeakPerspectiveCameras, translation: Array) -> Array:
        """Return the positions (F, 3) m of the body's origin, whose image is at `translation` (F, 2) px."""
        focal = np.full(len(translation), self.intrinsics.focal)
        towards = np.column_stack([translation, focal]) / cameras.scale[:, None]
        return _multiply(towards[:, None], self.rotation)[:, 0]

    def measure_depth(self, positions: Array) -> Array:
        """Return the depths (F,) in m of positions (F, 3) m in the real camera's frame, along the virtual axes."""
        return np.asarray((self.rotation[..., 2, :] * positions).sum(axis=-1))

    def to_real_camera(self, vectors: Array) -> Array:
        """Rotate vectors (F, J, 3) from the virtual cameras' frames into the real camera's frame."""
        return np.asarray(vectors @ self.rotation)

    def to_virtual_camera(self, vectors: Array) -> Array:
        """Rotate vectors (F, J, 3) from the real camera's frame into the virtual cameras' frames."""
        return np.asarray(vectors @ self.rotation.swapaxes(-1, -2))

    def body_rotations(self, cameras: WeakPerspectiveCameras) -> Array:
        """Return the rotations (F, 3, 3) from the body frame to the real camera's optical frame."""
        return _multiply(self.rotation.swapaxes(-1, -2), cameras.rotation)

    def weak_perspective_cameras(self, rotation: Array, roots: Array) -> WeakPerspectiveCameras:
        """Return the cameras whose `body_rotations` and `root_positions` these are: s = f / Z."""
        scale = self.intrinsics.focal / np.maximum(self.measure_depth(roots), MIN_DEPTH_M)
        return WeakPerspectiveCameras(scale, _multiply(self.rotation, rotation))


def _multiply(a: Array, b: Array) -> Array:
    # products (..., M, 3) and (..., 3, 3) summed in order, as BLAS may not do
    return np.asarray(a[..., :1] * b[..., :1, :] + a[..., 1:2] * b[..., 1:2, :] + a[..., 2:] * b[..., 2:, :])


def solver_focal(intrinsics: Intrinsics, use_perspective: bool) -> float:
    """Return the focal length in px for the solvers; infinite, for weak perspective, if it is not known."""
    return intrinsics.focal if intrinsics.is_focal_known and use_perspective else math.inf


def rotate_rays(rays: Array, rotation: Array) -> Array:
    """Turn rays (..., J, 2) by rotations (..., 3, 3); those that point backwards are far off the axis."""
    if rotation.ndim == 2:
        groups, rotations = rays.reshape(1, -1, 2), rotation[None]
    else:
        groups = rays.reshape(-1, *rays.shape[-2:])
        rotations = np.broadcast_to(rotation, (*rays.shape[:-2], 3, 3)).reshape(-1, 3, 3)
    rotated = engine.rotate_rays(np.ascontiguousarray(groups, float), np.ascontiguousarray(rotations))
    return rotated.reshape(rays.shape)


def rotation_to_optical_axis(rays: Array) -> Array:
    """Return the smallest rotations (F, 3, 3) that bring rays (F, 2), as x / z and y / z, to the optical axis."""
    return engine.turn_to_axes(np.ascontiguousarray(rays, float))
