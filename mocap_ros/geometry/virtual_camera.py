"""Virtual cameras that look at a person: rotations of the real one.

Weak perspective is good near the optical axis only, so the solvers, which start from it, work in the image of a
camera turned towards the person, and their answer is turned back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.weak_perspective import Cameras

Array = NDArray[np.float64]

NEAREST_RAY = 0.05


@dataclass(frozen=True, eq=False)
class View:
    """Virtual cameras that look at one person, one a frame or one for all.

    Attributes:
        turn: (F, 3, 3) or (3, 3) rotation from the real camera's optical frame to the virtual one's.
        intrinsics: of the real camera; the virtual ones have its focal length and no principal point.
    """

    turn: Array
    intrinsics: Intrinsics

    @staticmethod
    def of(rays: Array, weight: Array, times: Array, smoothing: float, intrinsics: Intrinsics) -> View:
        """Cameras that look at the middle of the seen joints.

        Args:
            rays: (F, J, 2) as of `Intrinsics.rays`; anything where the weight is 0.
            weight: (F, J).
            times: (F,) s, increasing.
            smoothing: s over which the direction is averaged, so that it does not jump with what is seen.
            intrinsics: of the real camera.
        """
        total = weight.sum(axis=1)
        middle = (weight[..., None] * rays).sum(axis=1) / np.maximum(total, 1e-12)[:, None]
        near = np.exp(-0.5 * ((times[:, None] - times) / (smoothing / 2)) ** 2) * (total > 0) + 1e-12 * (total > 0)
        return View(facing(near @ middle / np.maximum(near.sum(axis=1, keepdims=True), 1e-300)), intrinsics)

    def image(self, rays: Array) -> Array:
        """(F, J, 2) rays of the real camera -> px in the virtual ones, from their axes."""
        return self.intrinsics.focal * turned_rays(rays, self.turn)

    def roots(self, cameras: Cameras, translation: Array) -> Array:
        """(F, 3) m, the body's origin in the real camera's optical frame; translation (F, 2) px, virtual."""
        focal = self.intrinsics.focal
        depth = focal / cameras.scale[:, None]
        virtual = np.concatenate([translation / focal * depth, depth], axis=-1)
        return np.asarray((virtual[:, None] @ self.turn)[:, 0])

    def to_camera(self, vectors: Array) -> Array:
        """(F, J, 3) in the virtual cameras' frames -> in the real one's."""
        return np.asarray(vectors @ self.turn)

    def rotations(self, cameras: Cameras) -> Array:
        """(F, 3, 3) body to the real camera."""
        return np.asarray(np.swapaxes(self.turn, -1, -2) @ cameras.rotation)


def solver_focal(intrinsics: Intrinsics, perspective: bool) -> float:
    """px, as the solvers are to know it: only a real one makes a perspective projection, where that is wanted."""
    return intrinsics.focal if intrinsics.known and perspective else math.inf


def turned_rays(rays: Array, turn: Array) -> Array:
    """Rays (..., J, 2) of a camera as those of one turned by (..., 3, 3); what is behind it goes far out."""
    directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ np.swapaxes(turn, -1, -2)
    return np.asarray(directions[..., :2] / np.maximum(directions[..., 2:], NEAREST_RAY))


def facing(direction: Array) -> Array:
    """(F, 3, 3) least rotations that bring the rays (F, 2) (x / z, y / z) to the optical axis."""
    axis = np.concatenate([direction, np.ones_like(direction[..., :1])], axis=-1)
    x, y, z = np.moveaxis(axis / np.linalg.norm(axis, axis=-1, keepdims=True), -1, 0)
    share = 1 / (1 + z)
    out = np.empty((*axis.shape, 3))
    out[..., 0, 0], out[..., 1, 1] = 1 - x * x * share, 1 - y * y * share
    out[..., 0, 1] = out[..., 1, 0] = -x * y * share
    out[..., 0, 2], out[..., 1, 2] = -x, -y
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = x, y, z
    return out
