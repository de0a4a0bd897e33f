# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Factorisation of image points into cameras and basis shapes, as far as several rivals share it.

    W = M B,   M_f = (c_f1 R_f ... c_fK R_f),   B = (B_1; ...; B_K)

W (2F, J) holds the centred image points of F frames, R_f (2, 3) the camera of a frame, c_f its coefficients, and
B_k (3, J) the basis shapes. The singular value decomposition of rank 3K gives M' and B' with W = M' B', and leaves
an invertible matrix G open: M = M' G, B = G^-1 B'. If one of the basis shapes has the coefficient 1 in all frames,
its three columns G_1 satisfy the orthonormality constraints (Xiao et al. 2004, Akhter et al. 2009)

    M'_f G_1 G_1^T M'_f^T = I      for all f.

Once the cameras are known, the columns of all basis shapes are the null space of linear equations:

    M'_f G_k = c_fk R_f            for all f.

Image points and shapes are in m, for a camera of scale 1. No point may be missing. A reconstruction and its mirror
image in depth have the same image points, so that nothing here tells one from the other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mocap_ros.geometry.rotations import nearest_rotation

Array = NDArray[np.float64]

STARTS = 6  # initial values of the metric upgrade, which has local minima; more change no result by 1 mm
START_SEED = 0  # of the random ones among them; any fixed number
MAX_UPGRADE_EVALUATIONS = 100  # of one start
TIGHT = 1e-12  # tolerance; the minimum is flat: a body that deforms a little and turns a little look much the same
EXACT_COST = 1e-18  # sum of squares below which the constraints hold and no further start is tried
RANK_TOLERANCE = 1e-6  # relative; smaller singular values of M count as 0, as those of a fixed camera are
MIN_EIGENVALUE_SHARE = 1e-6  # of the largest one, in a matrix that has to be positive definite


def stack_points(points: Array) -> Array:
    """Return the measurement matrix W (2F, J) of image points (F, J, 2): x and y of one frame after the other."""
    centred = points - points.mean(axis=1, keepdims=True)
    return np.swapaxes(centred, 1, 2).reshape(-1, points.shape[1])


def factorise(measurements: Array, shapes: int) -> tuple[Array, Array]:
    """Factorise W (2F, J) with rank 3K into M' (F, 2, 3K), with entries as large as those of rotations, and B'.

    Raises:
        ValueError: W has too few points or frames for that rank.
    """
    rank = 3 * shapes
    if rank > min(measurements.shape):
        raise ValueError(f'{shapes} basis shapes need {rank} points and half as many frames')
    u, s, vt = np.linalg.svd(measurements, full_matrices=False)
    size = np.sqrt(len(u) / 3)
    return (u[:, :rank] * size).reshape(-1, 2, rank), s[:rank, None] / size * vt[:rank]


def solve_gram_matrix(rows: Array, *, equal_scales: bool) -> Array:
    """Solve r_f Q r_f^T = I for Q (3, 3) by linear least squares (Tomasi, Kanade 1992), and return G, G G^T = Q.

    Args:
        rows: (F, 2, 3) rows of the cameras before the upgrade.
        equal_scales: False if each camera has a scale of its own; then both rows are as long as each other and
            perpendicular, and only the mean of their squared lengths is 1.
    """

    def pair(a: Array, b: Array) -> Array:
        """Return the coefficients of the six entries of Q in a Q b^T."""
        i, j = np.triu_indices(3)
        return np.where(i == j, a[:, i] * b[:, j], a[:, i] * b[:, j] + a[:, j] * b[:, i])

    x, y = rows[:, 0], rows[:, 1]
    if equal_scales:
        equations = np.concatenate([pair(x, x), pair(y, y), pair(x, y)])
        values = np.concatenate([np.ones(2 * len(rows)), np.zeros(len(rows))])
    else:
        mean = (pair(x, x) + pair(y, y)).sum(axis=0, keepdims=True) / 2
        equations = np.concatenate([pair(x, x) - pair(y, y), pair(x, y), mean])
        values = np.concatenate([np.zeros(2 * len(rows)), [len(rows)]])
    q = np.linalg.lstsq(equations, values, rcond=None)[0]
    gram = np.zeros((3, 3))
    gram[np.triu_indices(3)] = q
    gram = gram + np.triu(gram, 1).T
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors * np.sqrt(np.maximum(values, MIN_EIGENVALUE_SHARE * np.abs(values).max())))


def find_rotations(motion: Array) -> Array:
    """Find the cameras of M' (F, 2, 3K) by the orthonormality constraints.

    Returns:
        (F, 3, 3) rotations from the frame of the shapes to the camera's optical frame.
    """
    frames, _, columns = motion.shape
    rng = np.random.default_rng(START_SEED)
    leading = np.zeros((columns, 3))
    leading[:3] = solve_gram_matrix(motion[..., :3], equal_scales=True)
    starts = [leading] + [leading + rng.standard_normal((columns, 3)) for _ in range(STARTS - 1)]
    if columns == 3:  # rigid: the linear solution is refined, and there is nothing else to start from
        starts = starts[:1]

    def residuals(g: Array) -> Array:
        rows = motion @ g.reshape(columns, 3)
        x, y = rows[:, 0], rows[:, 1]
        return np.concatenate([(x * x).sum(-1) - 1, (y * y).sum(-1) - 1, (x * y).sum(-1)])

    def jacobian(g: Array) -> Array:
        rows = motion @ g.reshape(columns, 3)
        x, y = rows[:, 0, None], rows[:, 1, None]
        mx, my = motion[:, 0, :, None], motion[:, 1, :, None]
        return np.concatenate([2 * mx * x, 2 * my * y, mx * y + my * x]).reshape(3 * frames, -1)

    best = None
    for start in starts:
        found = least_squares(
            residuals,
            start.ravel(),
            jacobian,
            method='lm',
            ftol=TIGHT,
            xtol=TIGHT,
            max_nfev=MAX_UPGRADE_EVALUATIONS,
        )
        if best is None or found.cost < best.cost:
            best = found
        if best.cost < EXACT_COST:
            break
    assert best is not None
    return nearest_rotation(motion @ best.x.reshape(columns, 3))


def find_coefficients(motion: Array, rotations: Array, shapes: int) -> Array:
    """Find the coefficients (F, K) of the basis shapes from M' (F, 2, 3K) and known cameras (F, 3, 3).

    The equations M'_f G_k = c_fk R_f say that M'_f G_k has no part perpendicular to R_f; their normal matrix has K
    vectors G_k to the smallest eigenvalues.
    """
    frames, _, columns = motion.shape
    direction = rotations[:, :2].reshape(frames, 6) / np.sqrt(2)
    each = np.einsum('fac,bd->fabcd', motion, np.eye(3)).reshape(frames, 6, 3 * columns)
    along = np.einsum('fi,fin->fn', direction, each)
    normal = np.einsum('fin,fim->nm', each, each, optimize=True) - along.T @ along
    vectors = np.linalg.eigh(normal)[1][:, :shapes]
    return np.asarray(along @ vectors)


def compose_motion(rotations: Array, coefficients: Array) -> Array:
    """Return M (2F, 3K) of cameras (F, 3, 3) and coefficients (F, K)."""
    frames, shapes = coefficients.shape
    return np.einsum('fk,fab->fakb', coefficients, rotations[:, :2]).reshape(2 * frames, 3 * shapes)


def solve_shapes(measurements: Array, rotations: Array, coefficients: Array) -> Array:
    """Return the shapes of all frames (F, J, 3), in the frame of the shapes: B = M^+ W, S_f = sum_k c_fk B_k."""
    basis = np.linalg.pinv(compose_motion(rotations, coefficients), rcond=RANK_TOLERANCE) @ measurements
    basis = basis.reshape(coefficients.shape[1], 3, -1)
    return np.einsum('fk,kaj->fja', coefficients, basis)


def turn_to_camera(shapes: Array, rotations: Array) -> Array:
    """Return shapes (F, J, 3) in the camera's optical frame."""
    return shapes @ np.swapaxes(rotations, 1, 2)


def reflect_in_depth(poses: Array) -> Array:
    """Return the poses (F, J, 3) that have the same image points and the opposite depth."""
    return poses * np.array([1.0, 1.0, -1.0])
