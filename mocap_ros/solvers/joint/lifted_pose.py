# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifted-pose term: the poses that the lifter network proposes are a robust prior (beyond TPAMI 2016).

    omega sum_tj rho( sum_c (q_tjc - y_tjc)^2 / v_tjc ),    q_tj = s_t R_t P_tj,    rho(a) = c^2 log(1 + a / c^2)

with y the lifted pose and v its variances along the camera's axes (the lifter gives both), and rho Cauchy's loss
of the whitened distance of a joint: the network proposes, and the image may overrule it. The term is linear in the
weights and free of the translation. The x and y coordinates of seen joints take part as well, since the network
has smoothed them over time.

The lifted poses also give the initial values of the weights and cameras (`lifted_start`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOAT, FLOATS_1D, FLOATS_2D, FLOATS_3D, FLOATS_4D, INPUT_1D, INPUT_3D, kernel
from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.models.lifter import concatenate_lifted
from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

MIN_STD_M = (
    0.01  # m; a smaller standard deviation of the lifter is not believed: its poses are no better than that
)


@dataclass(frozen=True, eq=False)
class LiftedPoseTerm:
    """The term of a batch.

    Attributes:
        joints: (N, J, 3) m, lifted poses in the sequence's unit, about the mean of the joints.
        precision: (N, J, 3) 1/m^2, inverse variances of these coordinates; 0 where nothing is known.
        weight: m^2, omega.
        robust_scale: standard deviations, scale c of Cauchy's loss.
    """

    joints: Array
    precision: Array
    weight: float
    robust_scale: float

    @staticmethod
    def build(windows: Sequence[Window], units: Array, config: SolverConfig) -> LiftedPoseTerm | None:
        """Return the term of a batch of windows, or None where none has lifted poses.

        Args:
            windows: all of them with lifted poses, or none; frames of these may be NaN.
            units: (P,) px/m, by which image points and lifted poses are divided.
            config: weight and robustness of the term.

        Raises:
            InputError: only some of the windows have lifted poses.
        """
        given = [w.lifted for w in windows if w.lifted is not None]
        if not given:
            return None
        if len(given) < len(windows):
            raise InputError('some windows of the batch have lifted poses and some have not')
        lifted = concatenate_lifted(given)
        frame_units = np.repeat(units, [len(poses.joints) for poses in given])
        joints, precision = _prepare(lifted.joints, lifted.std, frame_units)
        return LiftedPoseTerm(joints, precision, config.lifter_weight, config.lifter_robust_scale)

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of the term in each frame."""
        return _sum_loss(self.joints, self.precision, self.weight, self.robust_scale, fit.scaled_poses)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrices and gradients by the joints, in place."""
        _add_distances(
            self.joints,
            self.precision,
            self.weight,
            self.robust_scale,
            fit.scaled_poses,
            equations.joint_matrix,
            equations.joint_gradient,
        )

    def subsampled(self, kept: Subsample) -> LiftedPoseTerm:
        """Return the term of some frames only."""
        return replace(self, joints=self.joints[kept.frames], precision=self.precision[kept.frames])

    def with_components(self, k: int) -> LiftedPoseTerm:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the number of base poses."""
        return self


@kernel(types.UniTuple(FLOATS_3D, 2)(INPUT_3D, INPUT_3D, INPUT_1D))
def _prepare(joints: Array, std: Array, units: Array) -> tuple[Array, Array]:
    """Return the `joints` and the `precision` of the term.

    Args:
        joints: (N, J, 3) px, lifted poses; NaN where they are not known.
        std: (N, J, 3) px, their standard deviations.
        units: (N,) px/m, by which they are divided.
    """
    known_joints, precision = np.zeros(joints.shape), np.zeros(joints.shape)
    for t in range(len(joints)):
        for j in range(joints.shape[1]):
            for i in range(3):
                if np.isfinite(joints[t, j, i]):
                    known_joints[t, j, i] = joints[t, j, i] / units[t]
                    precision[t, j, i] = 1 / max(std[t, j, i] / units[t], MIN_STD_M) ** 2
    return known_joints, precision


@kernel(FLOATS_1D(FLOATS_3D, FLOATS_3D, FLOAT, FLOAT, FLOATS_3D))
def _sum_loss(joints: Array, precision: Array, weight: float, robust_scale: float, scaled_poses: Array) -> Array:
    """Return the value of the term in each frame, (N,) m^2."""
    out = np.zeros(len(joints))
    c = robust_scale**2
    for t in range(len(joints)):
        for j in range(joints.shape[1]):
            squared = 0.0
            for i in range(3):
                squared += precision[t, j, i] * (scaled_poses[t, j, i] - joints[t, j, i]) ** 2
            out[t] += weight * c * np.log1p(squared / c)
    return out


@kernel(void(FLOATS_3D, FLOATS_3D, FLOAT, FLOAT, FLOATS_3D, FLOATS_4D, FLOATS_2D))
def _add_distances(
    joints: Array,
    precision: Array,
    weight: float,
    robust_scale: float,
    scaled_poses: Array,
    joint_matrix: Array,
    joint_gradient: Array,
) -> None:
    """Add the quadratic approximation of the term to the matrices (N, J, 3, 3) and gradients (N, 3 J)."""
    for t in range(len(joints)):
        for j in range(joints.shape[1]):
            squared = 0.0
            for i in range(3):
                squared += precision[t, j, i] * (scaled_poses[t, j, i] - joints[t, j, i]) ** 2
            for i in range(3):
                stiffness = weight * precision[t, j, i] / (1 + squared / robust_scale**2)
                joint_matrix[t, j, i, i] += stiffness
                joint_gradient[t, 3 * j + i] += stiffness * (scaled_poses[t, j, i] - joints[t, j, i])
