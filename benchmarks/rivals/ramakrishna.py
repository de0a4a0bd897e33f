# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstructing 3D human pose from 2D image landmarks (Ramakrishna, Kanade, Sheikh, ECCV 2012).

    min_{s, R, A, w}  |x - s R (Q_0 + sum_{i in A} w_i Q_i)|^2     with   sum_bones |bone|^2 = that of Q_0

for every image alone. The set A of base poses grows by matching pursuit: the one is added whose image fits the
residual best, and cameras and weights are then fitted in turn. The dictionary is that of several kinds of motion,
so that it is overcomplete. With the weights w transformed so that the sum of the squared bone lengths is |u|^2,
they solve

    min_u u^T H u - 2 h^T u   with   |u| = r:      u = (H + l I)^-1 h,   |u(l)| = r,   l > -smallest eigenvalue.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import nearest_rotation

Array = NDArray[np.float64]

CAMERA_STEPS = 12  # fits of the camera to one pose; each lowers the error, and the last by less than a percent
ALTERNATIONS = 6  # of camera and weights after each new base pose; 60 change no error on motion capture by 1 mm
BISECTIONS = 60  # halvings of the interval of the Lagrange multiplier, down to rounding
RIDGE = 1e-9  # relative to the largest eigenvalue; base poses may depend on each other


def reconstruct(
    points: Array,
    mean: Array,
    base_poses: Array,
    bones: Sequence[tuple[int, int]],
    count: int,
    tolerance: float = 1e-4,
    alternations: int = ALTERNATIONS,
) -> Array:
    """Reconstruct the pose of each image alone.

    Args:
        points: (N, J, 2) m, image points of weak-perspective cameras.
        mean: Q_0 (J, 3) m.
        base_poses: dictionary (L, J, 3) of base poses.
        bones: pairs of joints whose squared distances have the same sum in every pose.
        count: largest number of base poses in a pose.
        tolerance: m, root mean square of the image errors below which no base pose is added.
        alternations: fits of camera and weights in turn after each new base pose.

    Returns:
        (N, J, 3) m in the camera's optical frame, centred, in the scale of the image.
    """
    images = points - points.mean(axis=1, keepdims=True)
    mean = mean - mean.mean(axis=0)
    base_poses = base_poses - base_poses.mean(axis=1, keepdims=True)
    poses = np.broadcast_to(mean, (len(images), *mean.shape))
    rotations, scales = fit_first_cameras(images, poses)
    chosen = np.zeros((len(images), 0), dtype=int)
    for _ in range(min(count, len(base_poses))):
        residual = images - _project(rotations, scales, poses)
        open_frames = np.sqrt((residual**2).sum(axis=2).mean(axis=1)) > tolerance
        if not open_frames.any():
            break
        chosen = np.concatenate([chosen, _choose_next(residual, rotations, base_poses, chosen)[:, None]], axis=1)
        used = base_poses[chosen]
        for _ in range(alternations):
            weights = fit_weights(images, rotations, scales, mean, used, bones)
            fitted = mean + np.einsum('nm,nmjc->njc', weights, used)
            poses = np.where(open_frames[:, None, None], fitted, poses)
            rotations, scales = improve_cameras(images, poses, rotations, scales)
    return np.asarray(scales[:, None, None] * (poses @ np.swapaxes(rotations, 1, 2)))


def fit_first_cameras(images: Array, poses: Array) -> tuple[Array, Array]:
    """Fit rotations (N, 3, 3) and scales (N,) to poses (N, J, 3), from the affine cameras x P^+."""
    affine = np.swapaxes(np.linalg.pinv(poses) @ images, 1, 2)
    return improve_cameras(images, poses, nearest_rotation(affine), np.sqrt((affine**2).sum(axis=(1, 2)) / 2))


def improve_cameras(images: Array, poses: Array, rotations: Array, scales: Array) -> tuple[Array, Array]:
    """Lower |x - s R P|^2 by completing the images with the depths of the last fit (Koschat and Swayne 1991)."""
    for _ in range(CAMERA_STEPS):
        depths = scales[:, None] * (poses @ rotations[:, 2, :, None])[..., 0]
        completed = np.concatenate([images, depths[..., None]], axis=2)
        u, s, vt = np.linalg.svd(np.swapaxes(completed, 1, 2) @ poses)
        sign = np.ones_like(s)
        sign[:, 2] = np.linalg.det(u @ vt)
        rotations = (u * sign[:, None]) @ vt
        seen = poses @ np.swapaxes(rotations[:, :2], 1, 2)
        scales = (seen * images).sum(axis=(1, 2)) / (seen**2).sum(axis=(1, 2))
    return rotations, scales


def fit_weights(
    images: Array, rotations: Array, scales: Array, mean: Array, used: Array, bones: Sequence[tuple[int, int]]
) -> Array:
    """Fit the weights (N, m) of base poses (N, m, J, 3) under the constraint on the bones."""
    frames, count = used.shape[:2]
    first, second = (list(ends) for ends in zip(*bones, strict=True))
    lengths = (used[:, :, first] - used[:, :, second]).reshape(frames, count, -1)
    of_mean = (mean[first] - mean[second]).ravel()
    seen = np.einsum('n,nab,nmjb->nmja', scales, rotations[:, :2], used, optimize=True).reshape(frames, count, -1)
    target = (images - _project(rotations, scales, mean)).reshape(frames, -1)
    values, vectors = np.linalg.eigh(lengths @ np.swapaxes(lengths, 1, 2))
    values = np.maximum(values, RIDGE * values[:, -1:])
    whiten = vectors / np.sqrt(values)[:, None]  # w = whiten v, |v|^2 = sum of squared lengths of what is added
    lengths = np.swapaxes(whiten, 1, 2) @ lengths
    seen = np.swapaxes(whiten, 1, 2) @ seen
    shift = lengths @ of_mean  # u = v + shift
    hessian = seen @ np.swapaxes(seen, 1, 2)
    linear = (seen @ target[..., None])[..., 0] + (hessian @ shift[..., None])[..., 0]
    u = minimise_on_sphere(hessian, linear, np.linalg.norm(shift, axis=1))
    return np.asarray((whiten @ (u - shift)[..., None])[..., 0])


def minimise_on_sphere(hessian: Array, linear: Array, radius: Array) -> Array:
    """Minimise u^T H u - 2 h^T u on |u| = r; H (N, m, m), h (N, m), r (N,)."""
    values, vectors = np.linalg.eigh(hessian)
    along = (np.swapaxes(vectors, 1, 2) @ linear[..., None])[..., 0]
    size = np.linalg.norm(along, axis=1)
    radius = np.maximum(radius, np.finfo(float).tiny)
    low = -values[:, 0] + np.abs(along[:, 0]) / radius  # here |u| is at least r
    high = -values[:, 0] + size / radius  # here at most
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        outside = _norm_at(values, along, middle) > radius
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    solved = along / np.maximum(values + high[:, None], np.finfo(float).tiny)
    return (vectors @ solved[..., None])[..., 0]


def _norm_at(values: Array, along: Array, multiplier: Array) -> Array:
    shifted = np.maximum(values + multiplier[:, None], np.finfo(float).tiny)
    return np.asarray(np.linalg.norm(along / shifted, axis=1))


def _project(rotations: Array, scales: Array, poses: Array) -> Array:
    return np.asarray(scales[:, None, None] * (poses @ np.swapaxes(rotations[:, :2], 1, 2)))


def _choose_next(residual: Array, rotations: Array, base_poses: Array, chosen: NDArray[np.intp]) -> Array:
    """Return for each image the base pose whose image is most parallel to the residual, among those not chosen."""
    seen = np.einsum('nab,ljb->nlja', rotations[:, :2], base_poses, optimize=True)
    seen = seen.reshape(len(residual), len(base_poses), -1)
    fit = np.abs(seen @ residual.reshape(len(residual), -1, 1))[..., 0] / np.linalg.norm(seen, axis=2)
    np.put_along_axis(fit, chosen, -1.0, axis=1)
    return fit.argmax(axis=1)
