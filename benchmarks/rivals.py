# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Methods of others that the project is compared with, each written from its paper.

**Factorisation** (Bregler, Hertzmann, Biermann, CVPR 2000, with the metric upgrade of Xiao et al. 2004 and Akhter
et al. 2009):

    W = M B,   M_f = (c_f1 R_f ... c_fK R_f),   B = (B_1; ...; B_K)

W (2F, J) holds the centred image points of F frames, R_f (2, 3) the camera of a frame, c_f its coefficients, and
B_k (3, J) the basis shapes. The singular value decomposition of rank 3K gives M' and B' with W = M' B', and leaves
an invertible matrix G open: M = M' G, B = G^-1 B'. If one of the basis shapes has the coefficient 1 in all frames,
its three columns satisfy M'_f G_1 G_1^T M'_f^T = I for all f; with known cameras the columns of all shapes are the
null space of M'_f G_k = c_fk R_f. A reconstruction and its mirror image in depth have the same image points.

**Sparse representation, each image alone** (Zhou et al., CVPR 2015 and TPAMI 2017): a convex relaxation

    min_M  1/2 |x - sum_i M_i B_i|^2 + a sum_i |M_i|_2          M_i (2, 3): c_i R_i, relaxed to any matrix

over example poses B_i, by the alternating direction method of multipliers with M = Z, multipliers Y and penalty m,

    M_i = prox_{a/m |.|_2}(Z_i - Y_i / m),   Z = (x B^T + m M + Y) (B B^T + m I)^-1,   Y = Y + m (M - Z)

and then the refinement min_{R, c} 1/2 |x - R sum_i c_i B_i|^2 + a |c|_1 from the rotation nearest to sum_i M_i.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mocap_ros.geometry.rotations import nearest_rotation

Array = NDArray[np.float64]

STARTS = 6  # initial values of the metric upgrade, which has local minima; more change no result by 1 mm
MAX_UPGRADE_EVALUATIONS = 100  # of one start
TIGHT = 1e-12  # tolerance; the minimum is flat: a body that deforms a little and turns a little look much the same
EXACT_COST = 1e-18  # sum of squares below which the constraints hold and no further start is tried
RANK_TOLERANCE = 1e-6  # relative; smaller singular values of M count as 0, as those of a fixed camera are
MIN_EIGENVALUE_SHARE = 1e-6  # of the largest one, in a matrix that has to be positive definite
IMBALANCE = 5.0  # ratio of |M - Z| and m |change of Z| beyond which m is doubled or halved, for speed
MAX_ITERATIONS = 400  # of the alternating direction method
TOLERANCE = 1e-4  # of |M - Z| and of m |change of Z|, relative to |Z|, at which it ends
ALTERNATIONS = 10  # of rotation and coefficients in the refinement
SHRINKAGE_STEPS = 40  # of the coefficients for one rotation
CAMERA_STEPS = 12  # fits of the camera to one pose; each lowers the error, and the last by less than a percent
MIN_NORM = 1e-12  # guards divisions


def stack_points(points: Array) -> Array:
    """Return the measurement matrix W (2F, J) of image points (F, J, 2): x and y of one frame after the other."""
    centred = points - points.mean(axis=1, keepdims=True)
    return np.swapaxes(centred, 1, 2).reshape(-1, points.shape[1])


def factorise(measurements: Array, shapes: int) -> tuple[Array, Array]:
    """Factorise W (2F, J) with rank 3K into M' (F, 2, 3K), with entries as large as those of rotations, and B'."""
    rank = 3 * shapes
    u, s, vt = np.linalg.svd(measurements, full_matrices=False)
    size = np.sqrt(len(u) / 3)
    return (u[:, :rank] * size).reshape(-1, 2, rank), s[:rank, None] / size * vt[:rank]


def solve_gram_matrix(rows: Array) -> Array:
    """Solve r_f Q r_f^T = I for Q by linear least squares, of rows r_f (F, 2, 3); return G, G G^T = Q."""
    i, j = np.triu_indices(3)

    def pair(a: Array, b: Array) -> Array:
        """Return the coefficients of the six entries of Q in a Q b^T."""
        return np.where(i == j, a[:, i] * b[:, j], a[:, i] * b[:, j] + a[:, j] * b[:, i])

    x, y = rows[:, 0], rows[:, 1]
    equations = np.concatenate([pair(x, x), pair(y, y), pair(x, y)])
    values = np.concatenate([np.ones(2 * len(rows)), np.zeros(len(rows))])
    gram = np.zeros((3, 3))
    gram[i, j] = np.linalg.lstsq(equations, values, rcond=None)[0]
    gram = gram + np.triu(gram, 1).T
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors * np.sqrt(np.maximum(values, MIN_EIGENVALUE_SHARE * np.abs(values).max())))


def find_rotations(motion: Array) -> Array:
    """Find the cameras (F, 3, 3), to the optical frame, of M' (F, 2, 3K) by the orthonormality constraints."""
    frames, _, columns = motion.shape
    rng = np.random.default_rng(0)
    leading = np.zeros((columns, 3))
    leading[:3] = solve_gram_matrix(motion[..., :3])
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
    options = {'method': 'lm', 'ftol': TIGHT, 'xtol': TIGHT, 'max_nfev': MAX_UPGRADE_EVALUATIONS}
    for start in starts:
        found = least_squares(residuals, start.ravel(), jacobian, **options)
        best = found if best is None or found.cost < best.cost else best
        if best.cost < EXACT_COST:
            break
    assert best is not None
    return nearest_rotation(motion @ best.x.reshape(columns, 3))


def find_coefficients(motion: Array, rotations: Array, shapes: int) -> Array:
    """Find the coefficients (F, K) of the shapes: M'_f G_k has no part perpendicular to R_f, as K eigenvectors."""
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


def factorise_points(points: Array, shapes: int) -> Array:
    """Reconstruct poses by the factorisation with the metric upgrade of all 3K columns.

    Args:
        points: (F, J, 2) m, image points of a camera of scale 1, none of them missing.
        shapes: number K of basis shapes; one means a rigid body (Tomasi and Kanade 1992).

    Returns:
        (F, J, 3) m in the camera's optical frame, centred; or their mirror image in depth.
    """
    measurements = stack_points(points)
    motion, _ = factorise(measurements, shapes)
    rotations = find_rotations(motion)
    coefficients = find_coefficients(motion, rotations, shapes)
    return turn_to_camera(solve_shapes(measurements, rotations, coefficients), rotations)


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


def represent_sparsely(points: Array, dictionary: Array, sparsity: float) -> Array:
    """Reconstruct the pose of each image alone, (N, J, 3) m in the camera's optical frame, centred.

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
    matrices = _relax(images, dictionary, sparsity)
    count = len(images)
    coefficients = np.linalg.norm(matrices, ord=2, axis=(2, 3))
    rotations = nearest_rotation(matrices.sum(axis=1))
    step = 1 / np.linalg.norm(dictionary.reshape(len(dictionary), -1), ord=2) ** 2
    for _ in range(ALTERNATIONS):
        seen = np.einsum('nab,ljb->nlja', rotations[:, :2], dictionary, optimize=True)
        seen = seen.reshape(count, len(dictionary), -1)
        gram, target = seen @ np.swapaxes(seen, 1, 2), seen @ images.reshape(count, -1, 1)
        ahead, momentum = coefficients, 1.0
        for _ in range(SHRINKAGE_STEPS):
            moved = ahead - step * (gram @ ahead[..., None] - target)[..., 0]
            shrunk = np.sign(moved) * np.maximum(np.abs(moved) - step * sparsity, 0)
            following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            ahead = shrunk + (momentum - 1) / following * (shrunk - coefficients)
            coefficients, momentum = shrunk, following
        poses = np.einsum('nl,ljc->njc', coefficients, dictionary)
        rotations, scales = improve_cameras(images, poses, rotations, np.ones(count))
        coefficients = scales[:, None] * coefficients
    return np.asarray(sizes * scales[:, None, None] * (poses @ np.swapaxes(rotations, 1, 2)))


def _relax(images: Array, dictionary: Array, sparsity: float) -> Array:
    """Return the matrices M_i (N, L, 2, 3) by the alternating direction method of multipliers."""
    stacked = dictionary.transpose(0, 2, 1).reshape(-1, dictionary.shape[1])  # B (3L, J)
    values, vectors = np.linalg.eigh(stacked.T @ stacked)
    turned = stacked @ vectors  # so that (B B^T + m I)^-1 = (I - turned diag(1 / (values + m)) turned^T) / m
    target = np.swapaxes(images, 1, 2) @ stacked.T  # (N, 2, 3L)
    out, z, multipliers = (np.zeros_like(target) for _ in range(3))
    penalty = np.full((len(images), 1, 1), 1.0)
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
    """Return prox_{amount |.|_2} of matrices (..., 2, 3), whose two singular values s1 >= s2 are lowered alike."""
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


def _by_pose(side_by_side: Array) -> Array:
    """(N, 2, 3L) -> (N, L, 2, 3)."""
    return side_by_side.reshape(len(side_by_side), 2, -1, 3).transpose(0, 2, 1, 3)


def _side_by_side(by_pose: Array) -> Array:
    """(N, L, 2, 3) -> (N, 2, 3L)."""
    return by_pose.transpose(0, 2, 1, 3).reshape(len(by_pose), 2, -1)
