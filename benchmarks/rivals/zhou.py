# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sparse representation for 3D shape estimation: a convex relaxation (Zhou et al., CVPR 2015 and TPAMI 2017).

    min_M  1/2 |x - sum_i M_i B_i|^2 + a sum_i |M_i|_2          M_i (2, 3): c_i R_i, relaxed to any matrix

B_i (3, J) are example poses, |M_i|_2 is the spectral norm, whose unit ball is the convex hull of the first two
rows of all rotations. The alternating direction method of multipliers splits M = Z, with multipliers Y and penalty
m:

    M_i = prox_{a/m |.|_2}(Z_i - Y_i / m)      the singular values less their projection on the l1 ball of size a/m
    Z   = (x B^T + m M + Y) (B B^T + m I)^-1
    Y   = Y + m (M - Z)

Each M_i = c_i R_i then turns its own example pose. The second form continues with one rotation for all of them
(the alternating refinement of 2017), beginning with the rotation nearest to sum_i M_i:

    min_{R, c}  1/2 |x - R sum_i c_i B_i|^2 + a |c|_1
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import nearest_rotation
from rivals.ramakrishna import improve_cameras

Array = NDArray[np.float64]

FIRST_PENALTY = 1.0  # m at the start, for images and example poses of mean square 1
IMBALANCE = 5.0  # ratio of |M - Z| and m |change of Z| beyond which m is doubled or halved, for speed
MAX_ITERATIONS = 400  # of the alternating direction method
TOLERANCE = 1e-4  # of |M - Z| and of m |change of Z|, relative to |Z|, at which it ends
ALTERNATIONS = 10  # of rotation and coefficients in the refinement
SHRINKAGE_STEPS = 40  # of the coefficients for one rotation
MIN_NORM = 1e-12  # guards divisions


def _minimise(images: Array, dictionary: Array, sparsity: float) -> Array:
    """Return the matrices M_i (N, L, 2, 3) by the alternating direction method of multipliers."""
    stacked = dictionary.transpose(0, 2, 1).reshape(-1, dictionary.shape[1])  # B (3L, J)
    values, vectors = np.linalg.eigh(stacked.T @ stacked)
    turned = stacked @ vectors  # so that (B B^T + m I)^-1 = (I - turned diag(1 / (values + m)) turned^T) / m
    target = np.swapaxes(images, 1, 2) @ stacked.T  # (N, 2, 3L)
    out, z, multipliers = (np.zeros_like(target) for _ in range(3))
    penalty = np.full((len(images), 1, 1), FIRST_PENALTY)
    todo = np.arange(len(images))
    for _ in range(MAX_ITERATIONS):
        split = _by_pose(z - multipliers / penalty)
        m = _side_by_side(shrink_spectral_norm(split, sparsity / penalty[:, 0]))
        a = target + penalty * m + multipliers
        before, z = z, (a - (a @ turned / (values + penalty)) @ turned.T) / penalty
        multipliers = multipliers + penalty * (m - z)
        out[todo] = m
        size = np.linalg.norm(z, axis=(1, 2)) + MIN_NORM
        apart = np.linalg.norm(m - z, axis=(1, 2))
        change = np.linalg.norm(z - before, axis=(1, 2)) * penalty[:, 0, 0]
        factor = np.where(apart > IMBALANCE * change, 2.0, np.where(change > IMBALANCE * apart, 0.5, 1.0))
        going = np.maximum(apart, change) > TOLERANCE * size
        if not going.any():
            break
        penalty = penalty * factor[:, None, None]
        todo, z, multipliers, target, penalty = (v[going] for v in (todo, z, multipliers, target, penalty))
    return _by_pose(out)


def shrink_spectral_norm(matrices: Array, amount: Array | float) -> Array:
    """Return prox_{amount |.|_2} of matrices (..., 2, 3).

    Of the two singular values s1 >= s2, the larger is lowered to max(s2, s1 - amount), and where they meet both to
    (s1 + s2 - amount) / 2, at least 0. The singular vectors are those of A A^T.
    """
    xx, yy = (matrices[..., 0, :] ** 2).sum(-1), (matrices[..., 1, :] ** 2).sum(-1)
    xy = (matrices[..., 0, :] * matrices[..., 1, :]).sum(-1)
    mean, half, spread = (xx + yy) / 2, (xx - yy) / 2, np.hypot((xx - yy) / 2, xy)
    s1, s2 = np.sqrt(mean + spread), np.sqrt(np.maximum(mean - spread, 0))
    new1 = np.where(s1 - s2 >= amount, s1 - amount, np.maximum((s1 + s2 - amount) / 2, 0))
    factor1, factor2 = new1 / np.maximum(s1, MIN_NORM), np.minimum(s2, new1) / np.maximum(s2, MIN_NORM)
    # A -> (f1 u1 u1^T + f2 u2 u2^T) A, and u1 u1^T = (I + [[half, xy], [xy, -half]] / spread) / 2
    spread = np.maximum(spread, MIN_NORM)
    both, apart = (factor1 + factor2) / 2, (factor1 - factor2) / (2 * spread)
    x = (both + apart * half)[..., None] * matrices[..., 0, :] + (apart * xy)[..., None] * matrices[..., 1, :]
    y = (apart * xy)[..., None] * matrices[..., 0, :] + (both - apart * half)[..., None] * matrices[..., 1, :]
    return np.stack([x, y], axis=-2)


@dataclass(frozen=True, eq=False)
class Relaxation:
    """The solution of the convex relaxation for N images.

    Attributes:
        images: (N, J, 2) centred, with the mean square 1.
        sizes: (N, 1, 1) m, by which the images were divided.
        dictionary: (L, J, 3) example poses, centred, each with the mean square 1.
        sparsity: a.
        matrices: M_i (N, L, 2, 3).
    """

    images: Array
    sizes: Array
    dictionary: Array
    sparsity: float
    matrices: Array

    def compose_poses(self) -> Array:
        """Return the poses (N, J, 3) m, each example pose turned by its own rotation, in the optical frame."""
        norms = np.linalg.norm(self.matrices, ord=2, axis=(2, 3))
        turned = np.einsum('nlab,ljb->nlja', nearest_rotation(self.matrices), self.dictionary, optimize=True)
        return np.asarray(self.sizes * np.einsum('nl,nlja->nja', norms, turned))

    def refine_poses(self) -> Array:
        """Return the poses (N, J, 3) m with one rotation for all example poses, in the optical frame."""
        images, dictionary, count = self.images, self.dictionary, len(self.images)
        coefficients = np.linalg.norm(self.matrices, ord=2, axis=(2, 3))
        rotations = nearest_rotation(self.matrices.sum(axis=1))
        step = 1 / np.linalg.norm(dictionary.reshape(len(dictionary), -1), ord=2) ** 2
        for _ in range(ALTERNATIONS):
            seen = np.einsum('nab,ljb->nlja', rotations[:, :2], dictionary, optimize=True)
            seen = seen.reshape(count, len(dictionary), -1)
            gram, target = seen @ np.swapaxes(seen, 1, 2), seen @ images.reshape(count, -1, 1)
            ahead, momentum = coefficients, 1.0
            for _ in range(SHRINKAGE_STEPS):
                moved = ahead - step * (gram @ ahead[..., None] - target)[..., 0]
                shrunk = np.sign(moved) * np.maximum(np.abs(moved) - step * self.sparsity, 0)
                following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
                ahead = shrunk + (momentum - 1) / following * (shrunk - coefficients)
                coefficients, momentum = shrunk, following
            poses = np.einsum('nl,ljc->njc', coefficients, dictionary)
            rotations, scales = improve_cameras(images, poses, rotations, np.ones(count))
            coefficients = scales[:, None] * coefficients
        return np.asarray(self.sizes * scales[:, None, None] * (poses @ np.swapaxes(rotations, 1, 2)))


def relax(points: Array, dictionary: Array, sparsity: float) -> Relaxation:
    """Solve the convex relaxation for each image alone.

    Args:
        points: (N, J, 2) m, image points of weak-perspective cameras.
        dictionary: (L, J, 3) example poses, turned to one heading.
        sparsity: a, for images and example poses whose mean square is 1.
    """
    images = points - points.mean(axis=1, keepdims=True)
    sizes = np.sqrt((images**2).mean(axis=(1, 2)))[:, None, None]
    dictionary = dictionary - dictionary.mean(axis=1, keepdims=True)
    dictionary = dictionary / np.sqrt((dictionary**2).mean(axis=(1, 2)))[:, None, None]
    images = images / sizes
    return Relaxation(images, sizes, dictionary, sparsity, _minimise(images, dictionary, sparsity))


def _by_pose(side_by_side: Array) -> Array:
    """(N, 2, 3L) -> (N, L, 2, 3)."""
    return side_by_side.reshape(len(side_by_side), 2, -1, 3).transpose(0, 2, 1, 3)


def _side_by_side(by_pose: Array) -> Array:
    """(N, L, 2, 3) -> (N, 2, 3L)."""
    return by_pose.transpose(0, 2, 1, 3).reshape(len(by_pose), 2, -1)
