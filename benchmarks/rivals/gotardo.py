# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Shape trajectories (Gotardo and Martinez 2011; Hamsici, Gotardo and Martinez 2012).

    min_X |W - M M^+ W|^2,   M_f = (c_f1 R_f ... c_fK R_f)

The cameras R_f come from the orthonormality constraints of `factorisation`, and the basis shapes M^+ W from M. The
coefficients c_f, the trajectory of the shape, are functions of few unknowns X:

    smooth time-trajectories (column space fitting, PAMI 2011):    C = D X,  D: the first d cosine functions
    kernel shape trajectories (ICCV 2011):   c_f1 = 1, c_fk = exp(-|z_f - z_t(k)|^2 / 2 s^2),  Z = D X in few
                                                                   dimensions, t(k): frames at equal distances
    spatially-smooth mappings (ECCV 2012, reference 4 of TPAMI 2016):    C = V X,  V: the first d eigenvectors of
                                                                   exp(-(1 - |p_f^H p_g|^2) / 2 s^2)

p_f are the centred image points of a frame as complex numbers, of norm 1, so that 1 - |p_f^H p_g|^2 is the squared
Procrustes distance of two images, invariant to rotations in the image plane. X is found by Levenberg-Marquardt
with the Jacobian of the variable projection (Kaufman 1975), beginning with the first K functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rivals.factorisation import (
    RANK_TOLERANCE,
    compose_motion,
    factorise,
    find_rotations,
    solve_shapes,
    stack_points,
    turn_to_camera,
)

Array = NDArray[np.float64]

MAX_STEPS = 50  # of Levenberg-Marquardt; most sequences need 10 to 40
TOLERANCE = 1e-7  # relative decrease of the objective at which the iteration ends
FIRST_DAMPING = 1e-3  # relative to the diagonal of the normal matrix
MAX_DAMPING = 1e8  # beyond it no step lowers the objective
EXACT_SHARE = 1e-24  # of |W|^2; a smaller objective is rounding


class Coefficients(Protocol):
    """Coefficients of the basis shapes as functions of the unknowns."""

    def initialise(self) -> Array:
        """Return the initial unknowns (N,)."""
        ...

    def evaluate(self, unknowns: Array) -> tuple[Array, Array]:
        """Return the coefficients (F, K) and their derivatives by the unknowns (N, F, K)."""
        ...


@dataclass(frozen=True, eq=False)
class LinearCoefficients:
    """C = D X.

    Attributes:
        basis: D (F, d), functions that the coefficients are composed of, the most important ones first.
        shapes: number K of basis shapes, at most d.
    """

    basis: Array
    shapes: int

    def initialise(self) -> Array:
        return np.eye(self.basis.shape[1], self.shapes).ravel()

    def evaluate(self, unknowns: Array) -> tuple[Array, Array]:
        slopes = np.einsum('fi,jk->ijfk', self.basis, np.eye(self.shapes))
        return self.basis @ unknowns.reshape(-1, self.shapes), slopes.reshape(len(unknowns), -1, self.shapes)


@dataclass(frozen=True, eq=False)
class KernelCoefficients:
    """Return c_f1 = 1, c_fk = exp(-|z_f - z_t(k)|^2 / 2), Z = D X.

    Attributes:
        basis: D (F, d), functions of time of which the first is constant.
        shapes: number K of basis shapes, the constant one included.
        dimensions: number of dimensions of z.
        width: standard deviation of the initial z; the kernel's width is 1.
    """

    basis: Array
    shapes: int
    dimensions: int
    width: float

    def initialise(self) -> Array:
        return (self.width * np.eye(self.basis.shape[1], self.dimensions, -1)).ravel()

    def evaluate(self, unknowns: Array) -> tuple[Array, Array]:
        places = self.basis @ unknowns.reshape(-1, self.dimensions)
        nodes = np.linspace(0, len(places) - 1, self.shapes - 1).round().astype(int)
        apart = places[:, None] - places[nodes]
        kernel = np.exp(-(apart**2).sum(axis=-1) / 2)
        by_function = self.basis[:, None] - self.basis[nodes]  # (F, K - 1, d)
        slopes = -np.einsum('fk,fkj,fki->ijfk', kernel, apart, by_function, optimize=True)
        ones, zeros = np.ones((len(places), 1)), np.zeros((len(unknowns), len(places), 1))
        slopes = slopes.reshape(len(unknowns), len(places), -1)
        return np.concatenate([ones, kernel], axis=1), np.concatenate([zeros, slopes], axis=2)


def cosine_basis(frames: int, functions: int) -> Array:
    """Return the first functions of the discrete cosine transform (F, d), each of mean square 1."""
    phase = np.pi * (np.arange(frames) + 0.5)[:, None] * np.arange(functions) / frames
    return np.cos(phase) * np.where(np.arange(functions) == 0, 1.0, np.sqrt(2))


def image_kernel_basis(points: Array, functions: int, width: float) -> Array:
    """Return the first eigenvectors (F, d) of the rotation-invariant kernel of image points (F, J, 2).

    Args:
        points: (F, J, 2) in any unit.
        functions: number d of eigenvectors; each has mean square 1.
        width: s of the kernel, as a share of the median Procrustes distance of two images.
    """
    centred = points - points.mean(axis=1, keepdims=True)
    shape = centred[..., 0] + 1j * centred[..., 1]
    shape /= np.linalg.norm(shape, axis=1, keepdims=True)
    squared = np.maximum(1 - np.abs(shape.conj() @ shape.T) ** 2, 0)
    kernel = np.exp(-squared / (2 * width**2 * np.median(squared)))
    vectors = np.linalg.eigh(kernel)[1][:, ::-1][:, :functions]
    return np.asarray(vectors * np.sqrt(len(points)))


def find_cameras(points: Array, shapes: int) -> Array:
    """Find the cameras (F, 3, 3) of image points (F, J, 2) by a factorisation with K basis shapes."""
    return find_rotations(factorise(stack_points(points), shapes)[0])


def reconstruct(points: Array, rotations: Array, model: Coefficients) -> Array:
    """Reconstruct poses from image points and cameras.

    Args:
        points: (F, J, 2) m, image points of a camera of scale 1.
        rotations: (F, 3, 3) from the frame of the shapes to the camera's optical frame, as `find_cameras` gives.
        model: the coefficients of the basis shapes.

    Returns:
        (F, J, 3) m in the camera's optical frame, centred; or their mirror image in depth.
    """
    measurements = stack_points(points)
    unknowns, damping = model.initialise(), FIRST_DAMPING
    coefficients, slopes = model.evaluate(unknowns)
    residual, outside, basis = _project(measurements, rotations, coefficients)
    cost = float((residual**2).sum())
    for _ in range(MAX_STEPS):
        images = np.einsum('fab,kbj->kfaj', rotations[:, :2], basis, optimize=True)
        columns = np.einsum('nfk,kfaj->fanj', slopes, images, optimize=True).reshape(len(measurements), -1)
        columns = (columns - outside @ (outside.T @ columns)).reshape(len(measurements), len(unknowns), -1)
        jacobian = -columns.transpose(1, 0, 2).reshape(len(unknowns), -1)
        gradient, normal = jacobian @ residual.ravel(), jacobian @ jacobian.T
        before = cost
        while damping < MAX_DAMPING:
            diagonal = normal.diagonal()
            damped = normal + damping * np.diag(diagonal + RANK_TOLERANCE * diagonal.max())
            tried = unknowns - np.linalg.lstsq(damped, gradient, rcond=None)[0]
            candidate = model.evaluate(tried)
            projected = _project(measurements, rotations, candidate[0])
            tried_cost = float((projected[0] ** 2).sum())
            if tried_cost < cost:
                unknowns, (coefficients, slopes), cost = tried, candidate, tried_cost
                residual, outside, basis = projected
                damping = max(damping / 10, 1e-12)
                break
            damping *= 4
        if before - cost <= TOLERANCE * before or cost <= EXACT_SHARE * (measurements**2).sum():
            break
    return turn_to_camera(solve_shapes(measurements, rotations, coefficients), rotations)


def _project(measurements: Array, rotations: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """Return W - M M^+ W (2F, J), orthonormal columns that span those of M, and the basis shapes (K, 3, J)."""
    u, s, vt = np.linalg.svd(compose_motion(rotations, coefficients), full_matrices=False)
    kept = s > RANK_TOLERANCE * s[0]
    u, s, vt = u[:, kept], s[kept], vt[kept]
    inside = u.T @ measurements
    basis = vt.T @ (inside / s[:, None])
    return measurements - u @ inside, u, basis.reshape(coefficients.shape[1], 3, -1)
