"""Virtual cameras that face a person.

A virtual camera has the centre of the real camera and is rotated so that its optical axis points at the person.
Weak perspective approximates a real camera well only near the optical axis. The solvers start from weak
perspective, so they work in the image of a virtual camera, and their solution is rotated back into the real
camera's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras

Array = NDArray[np.float64]

# 1, z of a ray whose z was 1 before the rotation; keeps rays at the side of the rotated camera and behind it
# finite and far outside the image
MIN_RAY_DEPTH = 0.05
MIN_TOTAL_WEIGHT = 1e-12  # 1; guards the division by the sum of confidence scores in frames without seen joints
MIN_FRAME_WEIGHT = 1e-12  # 1; lets distant frames define the direction where no near frame has a seen joint
MIN_DIVISOR = 1e-300  # 1; guards the division when no frame at all has a seen joint
MIN_DEPTH_M = 1e-3  # m; guards the division by the depth of the body's origin
SMOOTHING_REACH_STD = 10.0  # standard deviations; frames farther away would weigh less than 1e-21
FRAMES_PER_BLOCK = 1024  # frames averaged at once; bounds the memory, which grows with its square


@dataclass(frozen=True, eq=False)
class VirtualCamera:
    """Virtual cameras that face one person: one for each frame, or one for all frames.

    Attributes:
        rotation: (F, 3, 3) or (3, 3) rotation from the real camera's optical frame to the virtual camera's.
        intrinsics: intrinsics of the real camera. The virtual cameras have the same focal length, no distortion,
            and image points relative to their optical axes.
    """

    rotation: Array
    intrinsics: Intrinsics

    @staticmethod
    def look_at_person(
        rays: Array, weight: Array, times: Array, smoothing_s: float, intrinsics: Intrinsics
    ) -> VirtualCamera:
        """Return virtual cameras that look at the weighted centroid of the seen joints.

        Args:
            rays: (F, J, 2) rays from `Intrinsics.pixels_to_rays`; ignored where the weight is 0.
            weight: (F, J) confidence scores.
            times: (F,) s, increasing.
            smoothing_s: s over which the direction is averaged, so that it does not jump when joints appear or
                vanish; equal to two standard deviations of the Gaussian weights.
            intrinsics: intrinsics of the real camera.
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
        """Return one virtual camera for all frames, which looks at the weighted centroid of all their seen joints.

        Args:
            rays: (F, J, 2) rays from `Intrinsics.pixels_to_rays`; finite where the weight is 0.
            weight: (F, J) confidence scores.
            intrinsics: intrinsics of the real camera.
        """
        centre = np.einsum('fj,fjd->d', weight, rays) / max(weight.sum(), MIN_TOTAL_WEIGHT)
        return VirtualCamera(rotation_to_optical_axis(centre), intrinsics)

    def select_frames(self, frames: NDArray[np.intp] | slice) -> VirtualCamera:
        """Return the virtual cameras of the given frames."""
        return self if self.rotation.ndim == 2 else VirtualCamera(self.rotation[frames], self.intrinsics)

    def to_virtual_rays(self, rays: Array) -> Array:
        """Convert rays (F, J, 2) of the real camera to rays (F, J, 2) of the virtual ones."""
        return rotate_rays(rays, self.rotation)

    def root_positions(self, cameras: WeakPerspectiveCameras, translation: Array) -> Array:
        """Z = f / s, X = t_x Z / f, Y = t_y Z / f, rotated into the real camera's frame.

        Args:
            cameras: F weak-perspective cameras in the virtual cameras' images.
            translation: (F, 2) px, image points of the body's origin in the virtual cameras' images.

        Returns:
            (F, 3) m, positions of the body's origin in the real camera's optical frame.
        """
        focal = self.intrinsics.focal
        depth = focal / cameras.scale[:, None]
        virtual = np.concatenate([translation / focal * depth, depth], axis=-1)
        return np.asarray((virtual[:, None] @ self.rotation)[:, 0])

    def to_real_camera(self, vectors: Array) -> Array:
        """Rotate vectors (F, J, 3) from the virtual cameras' frames into the real camera's frame."""
        return np.asarray(vectors @ self.rotation)

    def to_virtual_camera(self, vectors: Array) -> Array:
        """Rotate vectors (F, J, 3) from the real camera's frame into the virtual cameras' frames."""
        return np.asarray(vectors @ np.swapaxes(self.rotation, -1, -2))

    def body_rotations(self, cameras: WeakPerspectiveCameras) -> Array:
        """Return the rotations (F, 3, 3) from the body frame to the real camera's optical frame."""
        return np.asarray(np.swapaxes(self.rotation, -1, -2) @ cameras.rotation)

    def weak_perspective_cameras(self, rotation: Array, roots: Array) -> WeakPerspectiveCameras:
        """Return the cameras whose `body_rotations` and `root_positions` these are: s = f / Z.

        Args:
            rotation: (F, 3, 3) rotations from the body frame to the real camera's optical frame.
            roots: (F, 3) m, positions of the body's origin in the real camera's optical frame.
        """
        depth = self.to_virtual_camera(roots[:, None])[:, 0, 2]
        scale = self.intrinsics.focal / np.maximum(depth, MIN_DEPTH_M)
        return WeakPerspectiveCameras(scale, self.rotation @ rotation)


def solver_focal(intrinsics: Intrinsics, use_perspective: bool) -> float:
    """Return the focal length in px for the solvers; infinite selects the weak-perspective projection.

    It is finite only if perspective is wanted and the focal length is known, not nominal.
    """
    return intrinsics.focal if intrinsics.is_focal_known and use_perspective else math.inf


def rotate_rays(rays: Array, rotation: Array) -> Array:
    """Convert rays (..., J, 2) of a camera to rays of a camera rotated by `rotation` (..., 3, 3).

    Rays that point backwards after the rotation are mapped to finite rays far from the optical axis.
    """
    directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ np.swapaxes(rotation, -1, -2)
    return np.asarray(directions[..., :2] / np.maximum(directions[..., 2:], MIN_RAY_DEPTH))


def rotation_to_optical_axis(rays: Array) -> Array:
    """Return the smallest rotations (F, 3, 3) that bring rays (F, 2), as x / z and y / z, to the optical axis."""
    axis = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
    x, y, z = np.moveaxis(axis / np.linalg.norm(axis, axis=-1, keepdims=True), -1, 0)
    inverse = 1 / (1 + z)
    out = np.empty((*axis.shape, 3))
    out[..., 0, 0], out[..., 1, 1] = 1 - x * x * inverse, 1 - y * y * inverse
    out[..., 0, 1] = out[..., 1, 0] = -x * y * inverse
    out[..., 0, 2], out[..., 1, 2] = -x, -y
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = x, y, z
    return out
