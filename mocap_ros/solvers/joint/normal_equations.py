# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The normal equations of a Gauss-Newton step, and how the terms of the objective add to them.

A step x solves

    (A - sum_p sum_b g_pb g_pb^T / F_p) x = -g

where A is block banded, with one n x n block a frame and couplings with the next frame, or with the next two where
accelerations count; the low-rank part comes from the mean bone lengths of each sequence p, which are eliminated
exactly (`bone_lengths`).

Terms of the joints' positions. Such a term need not know how the unknowns move the joints: it adds its matrix M_j
(3, 3) and half its gradient m_j (3,) by the scaled position q_j = s R P_j of each joint in the camera's frame.
With J = dq / dx (3 J, n),

    A_t += J^T M J - u u^T / w,    g_t += J^T m - u v / w,    u = J^T U

is added once for all of them (`transfer_from_joints`). U (3 J, 2), w and v (2,) belong to the translation of the
frame, which is eliminated: U holds the mixed second derivatives by the joints and the translation, w the second
derivative and v half the gradient by the translation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.blas import (
    add_product_transposed,
    add_transposed_product,
    factorise_cholesky,
    solve_lower,
)
from mocap_ros.compiled.kernel import BOOLS_1D, FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, INT, INTS_1D, kernel
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, write_point_jacobian
from mocap_ros.solvers.block_banded import Coupling
from mocap_ros.solvers.joint.state import Fit

Array = NDArray[np.float64]

MIN_INFORMATION = 1e-9  # m^2; keeps a block solvable in which the image does not determine an unknown


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The equations of a batch; terms add to the arrays in place while the equations are built.

    What takes long is left out for frames that are not active, whose equations nobody asks for.

    Attributes:
        is_active: (N,) whether the equations of a frame are complete.
        diagonal: (N, n, n) diagonal blocks of A.
        coupling: blocks of A between a frame and the next one or two.
        gradient: (N, n) half the gradient of the objective.
        bones: (N, n, B) the vectors g of the mean bone lengths.
        cameras: (N, 3, 3) the matrices s R; with the next two they give the derivatives J.
        scaled_poses: (N, J, 3) m, the joint positions q.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
        joint_matrix: (N, J, 3, 3) matrices M_j of all terms but the reprojection.
        image_matrix: (N, J, 3, 3) matrices M_j of the reprojection, v (1 0 a; 0 1 b)^T (1 0 a; 0 1 b), by
            which the noise estimate counts the unknowns.
        joint_gradient: (N, 3 J) the vectors m_j.
        translation_coupling: (N, 3 J, 2) the matrices U.
        translation_matrix: (N,) the numbers w.
        translation_gradient: (N, 2) the vectors v.
    """

    is_active: NDArray[np.bool_]
    diagonal: Array
    coupling: Coupling
    gradient: Array
    bones: Array
    cameras: Array
    scaled_poses: Array
    basis: Array
    joint_matrix: Array
    image_matrix: Array
    joint_gradient: Array
    translation_coupling: Array
    translation_matrix: Array
    translation_gradient: Array

    @staticmethod
    def begin(
        fit: Fit, basis: Array, bones: int, is_active: NDArray[np.bool_], coupled_frames: int = 1
    ) -> NormalEquations:
        """Return equations to which no term has added yet.

        Args:
            fit: of the state at hand.
            basis: (3 J, K) the base poses, a coordinate of a joint in each row.
            bones: number of bones.
            is_active: (N,) whether the equations of a frame are needed.
            coupled_frames: number of next frames with which a frame is coupled.
        """
        blocks, of_bones, of_pairs, corners, by_joints, by_image, gradient, of_joints, by_translation, w, v = (
            _allocate(
                fit.depth.shape[0], fit.depth.shape[1], basis.shape[1] + CAMERA_UNKNOWNS, bones, coupled_frames
            )
        )
        return NormalEquations(
            is_active=is_active,
            diagonal=blocks,
            coupling=Coupling(of_pairs, corners),
            gradient=gradient,
            bones=of_bones,
            cameras=np.exp(fit.state.log_scale)[:, None, None] * fit.state.rotation,
            scaled_poses=fit.scaled_poses,
            basis=basis,
            joint_matrix=by_joints,
            image_matrix=by_image,
            joint_gradient=of_joints,
            translation_coupling=by_translation,
            translation_matrix=w,
            translation_gradient=v,
        )

    def transfer_from_joints(self) -> None:
        """Add what the terms of the joints' positions have added to the matrix and the gradient, in place."""
        _transfer_from_joints(
            self.is_active,
            self.cameras,
            self.scaled_poses,
            self.basis,
            self.joint_matrix,
            self.image_matrix,
            self.joint_gradient,
            self.translation_coupling,
            self.translation_matrix,
            self.translation_gradient,
            self.diagonal,
            self.gradient,
        )

    def count_absorbed_coordinates(self, frames: NDArray[np.intp]) -> Array:
        """Return how many image coordinates of some frames (M,) the unknowns fit away, (M,).

        It is the trace of A_t^-1 D_t with D_t the part of A_t that the reprojection has added, plus the two
        coordinates that the translation takes; the neighbours of a frame are held.
        """
        return _count_absorbed_coordinates(
            frames,
            self.diagonal,
            self.cameras,
            self.scaled_poses,
            self.basis,
            self.image_matrix,
            self.translation_coupling,
            self.translation_matrix,
        )

    def with_frozen(self, frames: NDArray[np.bool_], old: NormalEquations) -> NormalEquations:
        """Put the matrices of the old equations into the frames (N,) of sequences that have converged.

        Their factorisation then stays that of the step with which they converged.
        """
        if frames.any():
            for new, before in (
                (self.diagonal, old.diagonal),
                (self.bones, old.bones),
                (self.cameras, old.cameras),
                (self.image_matrix, old.image_matrix),
                (self.translation_coupling, old.translation_coupling),
                (self.translation_matrix, old.translation_matrix),
            ):
                new[frames] = before[frames]
            for new, before in (
                (self.coupling.diagonal, old.coupling.diagonal),
                (self.coupling.corner, old.coupling.corner),
            ):
                new[:, frames] = before[:, frames]
            scaled_poses = np.where(frames[:, None, None], old.scaled_poses, self.scaled_poses)
            return replace(self, scaled_poses=scaled_poses)
        return self


@kernel(
    types.Tuple(
        (
            FLOATS_3D,
            FLOATS_3D,
            FLOATS_3D,
            FLOATS_4D,
            FLOATS_4D,
            FLOATS_4D,
            FLOATS_2D,
            FLOATS_2D,
            FLOATS_3D,
            FLOATS_1D,
            FLOATS_2D,
        )
    )(INT, INT, INT, INT, INT)
)
def _allocate(frames: int, joints: int, n: int, bones: int, coupled_frames: int) -> tuple[Array, ...]:
    """Return the arrays of equations, all 0: one compiled call in place of eleven."""
    return (
        np.zeros((frames, n, n)),
        np.zeros((frames, n, bones)),
        np.zeros((coupled_frames, frames, n)),
        np.zeros((coupled_frames, frames, CAMERA_UNKNOWNS, CAMERA_UNKNOWNS)),
        np.zeros((frames, joints, 3, 3)),
        np.zeros((frames, joints, 3, 3)),
        np.zeros((frames, n)),
        np.zeros((frames, 3 * joints)),
        np.zeros((frames, 3 * joints, 2)),
        np.zeros(frames),
        np.zeros((frames, 2)),
    )


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_2D, FLOATS_2D))
def write_joint_jacobian(camera: Array, scaled_pose: Array, basis: Array, out: Array) -> None:
    """Write the derivatives J (3 J, n) of the scaled joint positions q = s R P, P = Q_0 + sum_l theta_l Q_l.

    Args:
        camera: (3, 3) s R.
        scaled_pose: (J, 3) m, the positions q.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
        out: (3 J, n) overwritten.
    """
    k = basis.shape[1]
    for j in range(len(scaled_pose)):
        for row in range(3):
            a, b, c = camera[row, 0], camera[row, 1], camera[row, 2]
            for i in range(k):
                out[3 * j + row, i] = a * basis[3 * j, i] + b * basis[3 * j + 1, i] + c * basis[3 * j + 2, i]
        write_point_jacobian(scaled_pose[j], out, 3 * j, k)


@kernel(void(FLOATS_3D, FLOATS_2D, FLOATS_2D))
def _multiply_blocks(matrices: Array, jacobian: Array, out: Array) -> None:
    """Write the rows M_j J_j (3 J, n) of matrices (J, 3, 3) and a Jacobian (3 J, n)."""
    n = jacobian.shape[1]
    for j in range(len(matrices)):
        m = matrices[j]
        for row in range(3):
            for i in range(n):
                out[3 * j + row, i] = (
                    m[row, 0] * jacobian[3 * j, i]
                    + m[row, 1] * jacobian[3 * j + 1, i]
                    + m[row, 2] * jacobian[3 * j + 2, i]
                )


@kernel(
    void(
        BOOLS_1D,
        FLOATS_3D,
        FLOATS_3D,
        FLOATS_2D,
        FLOATS_4D,
        FLOATS_4D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_1D,
        FLOATS_2D,
        FLOATS_3D,
        FLOATS_2D,
    )
)
def _transfer_from_joints(
    is_active: NDArray[np.bool_],
    cameras: Array,
    scaled_poses: Array,
    basis: Array,
    joint_matrix: Array,
    image_matrix: Array,
    joint_gradient: Array,
    translation_coupling: Array,
    translation_matrix: Array,
    translation_gradient: Array,
    diagonal: Array,
    gradient: Array,
) -> None:
    """Add J^T M J - u u^T / w to the diagonal blocks and J^T m - u v / w to the gradient (head of this module)."""
    frames, n = gradient.shape
    rows = len(basis)
    jacobian, weighted = np.empty((rows, n)), np.empty((rows, n))
    for t in range(frames):
        if not is_active[t]:
            continue
        write_joint_jacobian(cameras[t], scaled_poses[t], basis, jacobian)
        _multiply_blocks(joint_matrix[t] + image_matrix[t], jacobian, weighted)
        add_transposed_product(1.0, jacobian, weighted, diagonal[t])
        by_joints = np.zeros((n, 1))
        add_transposed_product(1.0, jacobian, joint_gradient[t].reshape((rows, 1)), by_joints)
        by_translation = np.zeros((n, 2))
        if translation_matrix[t] > 0:
            add_transposed_product(1.0, jacobian, translation_coupling[t], by_translation)
            add_product_transposed(-1 / translation_matrix[t], by_translation, by_translation, diagonal[t])
            by_translation /= translation_matrix[t]
        for i in range(n):
            gradient[t, i] += (
                by_joints[i, 0]
                - by_translation[i, 0] * translation_gradient[t, 0]
                - by_translation[i, 1] * translation_gradient[t, 1]
            )


@kernel(FLOATS_1D(INTS_1D, FLOATS_3D, FLOATS_3D, FLOATS_3D, FLOATS_2D, FLOATS_4D, FLOATS_3D, FLOATS_1D))
def _count_absorbed_coordinates(
    examined: NDArray[np.intp],
    diagonal: Array,
    cameras: Array,
    scaled_poses: Array,
    basis: Array,
    image_matrix: Array,
    translation_coupling: Array,
    translation_matrix: Array,
) -> Array:
    """Return tr(A_t^-1 D_t) + 2 for some frames (M,); see `NormalEquations.count_absorbed_coordinates`."""
    rows, n = len(basis), diagonal.shape[1]
    joints = rows // 3
    jacobian = np.empty((rows, n))
    out = np.zeros(len(examined))
    # D_t = X X^T - u u^T / w, with two columns of X for each joint: M_j, of rank 2, is their sum of squares
    columns = np.empty((n, 2 * joints + 2))
    for index in range(len(examined)):
        t = examined[index]
        factor = diagonal[t].copy()
        for i in range(n):
            factor[i, i] += MIN_INFORMATION
        if not factorise_cholesky(factor):
            out[index] = 2.0
            continue
        write_joint_jacobian(cameras[t], scaled_poses[t], basis, jacobian)
        for j in range(joints):
            m = image_matrix[t, j]
            root = np.sqrt(max(m[0, 0], 0.0))
            inverse = 1 / root if root > 0 else 0.0
            for i in range(n):
                x, y, z = jacobian[3 * j, i], jacobian[3 * j + 1, i], jacobian[3 * j + 2, i]
                columns[i, 2 * j] = root * x + inverse * m[0, 2] * z
                columns[i, 2 * j + 1] = root * y + inverse * m[1, 2] * z
        by_translation = np.zeros((n, 2))
        add_transposed_product(1.0, jacobian, translation_coupling[t], by_translation)
        columns[:, 2 * joints :] = by_translation
        solve_lower(factor, columns)
        total = 0.0
        for i in range(n):
            for column in range(2 * joints):
                total += columns[i, column] ** 2
            if translation_matrix[t] > 0:
                for column in range(2 * joints, 2 * joints + 2):
                    total -= columns[i, column] ** 2 / translation_matrix[t]
        out[index] = 2.0 + total
    return out
