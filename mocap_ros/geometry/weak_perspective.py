"""Weak-perspective cameras: closed-form start and refinement (TPAMI 2016, section 3.2).

A camera has a scale and a rotation for each frame; its image of a pose is `scale * R[:2] @ P + t`. The
translation t is never a free unknown: it is whatever brings the weighted centroids of image and projection
together, so both are centred first (`centred_on_seen`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import cross_matrix, nearest_rotation, small_rotation

Array = NDArray[np.float64]


PLANAR_BODY = 1e-3


@dataclass(frozen=True, eq=False)
class Cameras:
    """Weak-perspective cameras of F frames.

    Attributes:
        scale: (F,) image units per metre.
        rotation: (F, 3, 3) body frame to camera optical frame (x right, y down, z forward).
    """

    scale: Array
    rotation: Array

    @property
    def matrix(self) -> Array:
        """(F, 2, 3) left part of the paper's M (eq. 14)."""
        return np.asarray(self.scale[:, None, None] * self.rotation[:, :2])

    def project(self, poses: Array) -> Array:
        """(F, J, 3) poses -> (F, J, 2) image points, up to translation."""
        return poses @ np.swapaxes(self.matrix, -1, -2)

    def where(self, take: NDArray[np.bool_], other: Cameras) -> Cameras:
        """These cameras where `take` (F,) is true, the others elsewhere."""
        return Cameras(
            np.where(take, self.scale, other.scale),
            np.where(take[:, None, None], self.rotation, other.rotation),
        )


def centred_on_seen(points: Array, weight: Array) -> tuple[Array, Array]:
    """Points (..., J, D) relative to their weighted centroid, and the centroids (..., D)."""
    total = np.maximum(weight.sum(axis=-1), 1e-12)[..., None]
    centroid = (weight[..., None] * points).sum(axis=-2) / total
    return points - centroid[..., None, :], centroid


def closed_form(poses: Array, image: Array, weight: Array, times: Array, window: float) -> Cameras:
    """Least-squares affine camera, made weak perspective (eq. 10 and 11).

    The paper solves each frame alone (`window` 0). Frames of a short window sharing one camera keep the answer
    stable for bodies seen from the front, which are nearly planar, and for missing points.

    Args:
        poses: (F, J, 3) m.
        image: (F, J, 2) image points, any where the weight is 0.
        weight: (F, J).
        times: (F,) s, increasing.
        window: s; frames at most half of it away take part in a frame's camera.

    Returns:
        Cameras whose scale is the root mean square of the rows of M (eq. 11 as printed is 0.707 of it).
    """
    body, _ = centred_on_seen(poses, weight)
    seen, _ = centred_on_seen(image, weight)
    weighted = np.swapaxes(body * weight[..., None], -1, -2)
    moments = _sum_nearby(weighted @ body, times, window)
    cross = _sum_nearby(weighted @ seen, times, window)
    ridge = PLANAR_BODY * np.trace(moments, axis1=-2, axis2=-1) + 1e-12
    affine = np.swapaxes(np.linalg.solve(moments + ridge[:, None, None] * np.eye(3), cross), -1, -2)
    scale = np.sqrt((affine**2).sum(axis=(-2, -1)) / 2)
    return Cameras(np.maximum(scale, 1e-9), nearest_rotation(affine))


def _sum_nearby(values: Array, times: Array, window: float) -> Array:
    """(F, ...) sums over the frames at most half of `window` s away."""
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    first = np.searchsorted(times, times - window / 2 - 1e-9)
    last = np.searchsorted(times, times + window / 2 + 1e-9, side='right')
    return np.asarray(total[last] - total[first])


@dataclass(frozen=True, eq=False)
class CameraProblem:
    """What the cameras of all frames must fit while the poses stay fixed (eq. 13).

    Attributes:
        body: (F, J, 3) poses, centred on the seen joints.
        image: (F, J, 2) image points, centred likewise.
        weight: (F, J) of the squared reprojection errors.
        flip: (F - 1,) of the squared changes of M between neighbours (eq. 12).
    """

    body: Array
    image: Array
    weight: Array
    flip: Array

    def data_cost(self, cameras: Cameras) -> Array:
        """(F,) weighted squared reprojection errors."""
        error = cameras.project(self.body) - self.image
        return np.asarray((self.weight[..., None] * error**2).sum(axis=(-2, -1)))

    def flip_cost(self, cameras: Cameras) -> Array:
        """(F - 1,) weighted squared changes of M."""
        change = np.diff(cameras.matrix, axis=0)
        return np.asarray(self.flip * (change**2).sum(axis=(-2, -1)))

    def local_cost(self, cameras: Cameras) -> Array:
        """(F,) everything that depends on each frame's own camera."""
        cost = self.data_cost(cameras)
        flip = self.flip_cost(cameras)
        cost[1:] += flip
        cost[:-1] += flip
        return cost

    def gauss_newton_step(self, cameras: Cameras, damping: Array) -> Cameras:
        """Every frame's camera moved towards its own minimum, its neighbours held."""
        # d(scale * R[:2] P) = scale * ((omega x R P)[:2]) + dlog(scale) * scale * (R P)[:2]
        turned = cameras.scale[:, None, None] * (self.body @ np.swapaxes(cameras.rotation, -1, -2))
        jac = np.concatenate([-cross_matrix(turned)[..., :2, :], turned[..., :2, None]], axis=-1)
        error = turned[..., :2] - self.image
        w = self.weight[..., None, None]
        normal = (np.swapaxes(jac, -1, -2) @ (w * jac)).sum(axis=1)
        gradient = (np.swapaxes(jac, -1, -2) @ (w * error[..., None])).sum(axis=1)[..., 0]

        rows = cameras.scale[:, None, None] * cameras.rotation
        columns = np.swapaxes(rows, -1, -2)
        m_jac = np.concatenate([-cross_matrix(columns)[..., :2, :], columns[..., :2, None]], axis=-1)
        m_normal = (np.swapaxes(m_jac, -1, -2) @ m_jac).sum(axis=1)
        change = np.diff(columns[..., :2], axis=0)
        pull = np.zeros_like(columns[..., :2])
        pull[1:] += self.flip[:, None, None] * change
        pull[:-1] -= self.flip[:, None, None] * change
        stiffness = np.zeros(len(rows))
        stiffness[1:] += self.flip
        stiffness[:-1] += self.flip
        normal += stiffness[:, None, None] * m_normal
        gradient += (np.swapaxes(m_jac, -1, -2) @ pull[..., None]).sum(axis=1)[..., 0]

        diagonal = np.einsum('fii->fi', normal)
        diagonal *= 1 + damping[:, None]
        diagonal += 1e-12
        step = -np.linalg.solve(normal, gradient[..., None])[..., 0]
        return Cameras(
            cameras.scale * np.exp(np.clip(step[:, 3], -1, 1)),
            small_rotation(step[:, :3]) @ cameras.rotation,
        )


def refine(problem: CameraProblem, cameras: Cameras, sweeps: int = 2) -> Cameras:
    """Cameras of all frames, improved with the poses held.

    The paper goes through the frames one after the other. A camera touches only its neighbours', so here all
    even frames move at once, then all odd ones: the same block-coordinate descent, without a loop over frames.
    No frame's step is taken unless it lowers the objective.
    """
    frames = len(cameras.scale)
    damping = np.full(frames, 1e-3)
    for _ in range(sweeps):
        for parity in (0, 1):
            mine = np.arange(frames) % 2 == parity
            tried = problem.gauss_newton_step(cameras, damping).where(mine, cameras)
            better = problem.local_cost(tried) <= problem.local_cost(cameras)
            cameras = tried.where(mine & better, cameras)
            damping = np.where(mine, np.where(better, damping / 3, damping * 10), damping)
    return cameras
