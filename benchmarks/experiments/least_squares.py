# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver as a residual vector with a sparse Jacobian, for SciPy's `least_squares`.

The unknowns of a frame are the weights in standard deviations, the rotation vector from the initial rotation, the
log scale and the translation. Further unknowns are the mean lengths of the bones, which keeps the Jacobian sparse.
At the optimum of the mean lengths, the sum of squares is the objective of `mocap_ros.solvers.joint`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import (
    bsr_array,
    coo_array,
    csr_array,
    diags_array,
    eye_array,
    hstack,
    kron,
    vstack,
)

from mocap_ros.geometry.rotations import cross_matrix, rotation_from_vector
from mocap_ros.models.base_poses import arrange_model
from mocap_ros.solvers.joint.batch import State
from mocap_ros.solvers.joint.differences import CAMERA_FEATURES
from mocap_ros.solvers.joint.objective import JointObjective
from mocap_ros.solvers.joint.reference import measure

Array = NDArray[np.float64]


@dataclass
class Progress:
    """Objective and CPU time in s at every point that SciPy accepted, or evaluated if it uses differences."""

    cost: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class SparseProblem:
    """The objective of one sequence, and its initial state."""

    problem: JointObjective
    start: State

    @property
    def frames(self) -> int:
        return len(self.start.theta)

    @property
    def width(self) -> int:
        return len(self.problem.model.std) + 6

    def pack(self, state: State) -> Array:
        """Return the vector of unknowns of a state that has the initial rotations."""
        parts = [
            state.theta / self.problem.model.std,
            np.zeros((self.frames, 3)),
            state.log_scale[:, None],
            state.translation,
        ]
        length = measure(self.problem, state).length
        return np.concatenate([np.concatenate(parts, axis=1).ravel(), length.mean(axis=0)])

    def unpack(self, x: Array) -> tuple[State, Array, Array]:
        """Return the state, the rotation vectors (F, 3) and the mean bone lengths (B,)."""
        each = x[: self.frames * self.width].reshape(self.frames, self.width)
        k = self.width - 6
        vector = each[:, k : k + 3]
        state = State(
            each[:, :k] * self.problem.model.std,
            rotation_from_vector(vector) @ self.start.rotation,
            each[:, k + 3].copy(),
            each[:, k + 4 :].copy(),
        )
        return state, vector, x[self.frames * self.width :]

    def _data_rows(self, error: Array) -> tuple[Array, Array]:
        """Return factors g (F, J) for which |g error|^2 is the robust loss, and their derivatives by |error|^2."""
        p = self.problem
        squared = (error**2).sum(axis=-1)
        scale = np.full_like(squared, p.robust_scale**2)
        with np.errstate(divide='ignore', invalid='ignore'):
            u = squared / scale
            ratio = np.where(u > 1e-6, np.log1p(u) / u, 1 - u / 2)
            slope = np.where(u > 1e-6, (1 / (1 + u) - ratio) / u, -0.5 + 2 * u / 3) / scale
        factor = np.sqrt(ratio)
        return factor, slope / (2 * factor)

    def residuals(self, x: Array) -> Array:
        p = self.problem
        state, _, means = self.unpack(x)
        found = measure(p, state)
        factor, _ = self._data_rows(found.error)
        rows = [
            (np.sqrt(p.batch.score) * factor)[..., None] * found.error,
            np.sqrt(p.bone_weight) * (found.length - means),
            np.sqrt(p.prior) * state.theta,
            *(difference.residuals(found.features) for difference in p.differences),
        ]
        return np.concatenate([r.ravel() for r in rows])

    def jacobian(self, x: Array) -> csr_array:
        p = self.problem
        state, vector, _ = self.unpack(x)
        frames, k = state.theta.shape
        bones = len(p.bone_weight)
        turn = _left_jacobian(vector)
        found, arrays = measure(p, state), arrange_model(p.model)
        turned, error = found.scaled_pose, found.error
        factor, slope = self._data_rows(error)

        def by_frame(blocks: Array, first: int = 0, of_means: Array | None = None) -> coo_array:
            """Return the rows of dense blocks (F, R, C) by the unknowns of their frames from the first one on."""
            rows, columns = blocks.shape[1:]
            wide = np.zeros((len(blocks), rows, self.width))
            wide[..., first : first + columns] = blocks
            own = bsr_array((wide, np.arange(len(blocks)), np.arange(len(blocks) + 1)))
            means = coo_array((len(blocks) * rows, bones)) if of_means is None else of_means
            return hstack([own, means])

        m = np.exp(state.log_scale)[:, None, None] * state.rotation[:, :2]
        basis = np.moveaxis(p.model.components * p.model.std[:, None, None], 0, -1)
        raw = np.zeros((frames, len(basis), 2, self.width))
        raw[..., :k] = np.einsum('fic,jck->fjik', m, basis)
        raw[..., k : k + 3] = (-cross_matrix(turned) @ turn[:, None])[..., :2, :]
        raw[..., k + 3] = turned[..., :2]
        raw[..., k + 4 :] = np.eye(2)
        along = (error[..., None] * raw).sum(axis=2, keepdims=True)
        data = factor[..., None, None] * raw + 2 * (slope[..., None] * error)[..., None] * along
        data *= np.sqrt(p.batch.score)[..., None, None]

        direction = basis[arrays.children] - basis[arrays.parents]
        root = np.sqrt(p.bone_weight)
        lengths = root[:, None] * np.einsum('fbc,bck->fbk', found.direction, direction)
        prior = np.diag(np.sqrt(p.prior) * p.model.std)

        columns = np.swapaxes(state.rotation, -1, -2)
        of_columns = (-cross_matrix(columns) @ turn[:, None])[..., :2, :]  # (F, 3, 2, 3)
        of_rows = np.swapaxes(of_columns, 1, 2).reshape(frames, 6, 3)
        scale = np.exp(state.log_scale)[:, None, None]
        features = np.zeros((frames, k + CAMERA_FEATURES, k + 4))
        features[:, range(k), range(k)] = p.model.std
        features[:, k : k + 6, k : k + 3], features[:, k + 6 : k + 12, k : k + 3] = scale * of_rows, of_rows
        features[:, k : k + 6, k + 3] = (scale * state.rotation[:, :2]).reshape(frames, 6)
        features[:, -1, k + 3] = 1.0

        rows = [
            by_frame(data.reshape(frames, -1, self.width)),
            by_frame(lengths, 0, kron(np.ones((frames, 1)), np.diag(-root))),
            by_frame(np.tile(prior, (frames, 1, 1))),
        ]
        for difference in p.differences:
            weighted = by_frame(np.sqrt(difference.weight)[:, None] * features)
            rows.append(_combine(difference.factors[: frames - difference.order], k + CAMERA_FEATURES) @ weighted)
        return csr_array(vstack(rows))

    def solve(self, differences: bool = False, **options: Any) -> tuple[State, Progress, int]:
        """Minimise the objective.

        Args:
            differences: whether to use a 2-point Jacobian.
            options: options of `least_squares`.

        Returns:
            The optimum, the progress, and the number of Jacobians.
        """
        progress = Progress()
        start_s = time.process_time()

        def note(squares: float) -> None:
            progress.cost.append(squares)
            progress.seconds.append(time.process_time() - start_s)

        def residuals(x: Array) -> Array:
            rows = self.residuals(x)
            note(float(rows @ rows))
            return rows

        def jacobian(x: Array) -> csr_array:
            note(float((self.residuals(x) ** 2).sum()))
            return self.jacobian(x)

        x0 = self.pack(self.start)
        if differences:
            pattern = self.jacobian(x0 + 1e-3) != 0
            found = least_squares(residuals, x0, '2-point', jac_sparsity=pattern, method='trf', **options)
        else:
            found = least_squares(self.residuals, x0, jacobian, method='trf', **options)
        note(2 * float(found.cost))
        return self.unpack(found.x)[0], progress, int(found.njev)


def _left_jacobian(vector: Array) -> Array:
    """Return J (..., 3, 3) for which exp(v + dv) = exp(J dv) exp(v) to first order."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = cross_matrix(vector)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + a * k + b * (k @ k)


def _combine(factors: Array, size: int) -> csr_array:
    """Return the matrix that adds blocks of rows of n neighbouring frames with factors (F - n + 1, n)."""
    count, neighbours = factors.shape
    shape = (count, count + neighbours - 1)
    by_frame = diags_array(list(factors.T), offsets=list(range(neighbours)), shape=shape)
    return csr_array(kron(by_frame, eye_array(size)))
