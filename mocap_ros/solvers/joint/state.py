# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The unknowns of the joint solver, and what follows from them for the terms of its objective."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, kernel
from mocap_ros.geometry.rotations import write_rotation_from_vector
from mocap_ros.models.base_poses import BasePoses

Array = NDArray[np.float64]

MAX_LOG_SCALE_STEP = (
    1.0  # change of the logarithm of the scale in one step; a larger step is a failed linearisation
)


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of all frames.

    A step of the solver has K + 4 numbers a frame: changes of the weights, a rotation vector on the camera's side,
    and the change of the logarithm of the scale. The translation always follows from the others.

    Attributes:
        theta: (N, K) m, base-pose weights.
        rotation: (N, 3, 3) body frame to camera frame.
        log_scale: (N,) logarithm of the scale, which is measured in the sequence's unit (1 at its median start).
        translation: (N, 2) m, image of the body's origin in the sequence's unit.
    """

    theta: Array
    rotation: Array
    log_scale: Array
    translation: Array

    def advanced(self, step: Array) -> State:
        """Return the state after a step (N, K + 4)."""
        theta, rotation, log_scale = self.theta.copy(), self.rotation.copy(), self.log_scale.copy()
        _advance(np.ascontiguousarray(step), theta, rotation, log_scale)
        return State(theta, rotation, log_scale, self.translation)

    def select(self, frames: NDArray[np.intp]) -> State:
        """Return the state of some frames."""
        return State(self.theta[frames], self.rotation[frames], self.log_scale[frames], self.translation[frames])

    def with_components(self, k: int) -> State:
        """Return the state with the first `k` weights only."""
        return replace(self, theta=self.theta[:, :k])

    def with_leading_weights(self, other: State) -> State:
        """Return the other state, with the weights that it lacks taken from this one."""
        k = other.theta.shape[1]
        return replace(other, theta=np.concatenate([other.theta, self.theta[:, k:]], axis=1))

    def where(self, chosen: NDArray[np.bool_], other: State) -> State:
        """Return this state in the frames that are `chosen` (N,), and the other state elsewhere."""
        return State(
            np.where(chosen[:, None], self.theta, other.theta),
            np.where(chosen[:, None, None], self.rotation, other.rotation),
            np.where(chosen, self.log_scale, other.log_scale),
            np.where(chosen[:, None], self.translation, other.translation),
        )


@kernel(void(FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_1D))
def _advance(step: Array, theta: Array, rotation: Array, log_scale: Array) -> None:
    """Add a step (N, K + 4) to the other arguments, in place."""
    k = theta.shape[1]
    turn = np.empty((3, 3))
    vector = np.empty(3)
    for t in range(len(theta)):
        for i in range(k):
            theta[t, i] += step[t, i]
        for i in range(3):
            vector[i] = step[t, k + i]
        write_rotation_from_vector(vector, turn)
        before = rotation[t].copy()
        for i in range(3):
            for j in range(3):
                rotation[t, i, j] = (
                    turn[i, 0] * before[0, j] + turn[i, 1] * before[1, j] + turn[i, 2] * before[2, j]
                )
        log_scale[t] += min(max(step[t, k + 3], -MAX_LOG_SCALE_STEP), MAX_LOG_SCALE_STEP)


@dataclass(frozen=True, eq=False)
class Fit:
    """A state, and the quantities that the terms of the objective measure in it.

    Attributes:
        state: the unknowns.
        model: base poses.
        scaled_poses: (N, J, 3) m, s_t R_t P_tj: the scaled poses about the body's origin, in the camera's frame.
        depth: (N, J) depth of a joint over that of the body's origin; 1 under weak perspective.
        error: (N, J, 2) m, reprojection errors.
        squared_error: (N, J) m^2, squared lengths of these.
        bone_direction: (N, B, 3) unit vectors along the bones, body frame.
        bone_length: (N, B) m.
        bone_excess: (N, B) m, bone lengths less their mean over the sequence.
        mean_bone_length: (P, B) m, mean of the bone lengths over the sequence and what came before it.
    """

    state: State
    model: BasePoses
    scaled_poses: Array
    depth: Array
    error: Array
    squared_error: Array
    bone_direction: Array
    bone_length: Array
    bone_excess: Array
    mean_bone_length: Array
