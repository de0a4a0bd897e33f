"""What the joint solver moves: the unknowns of all frames, how they fit the image, and the equations of a step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import small_rotation
from mocap_ros.solvers.block_banded import Coupling

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """Unknowns of all frames: weights (N, K), rotation (N, 3, 3), log scale (N,), translation (N, 2)."""

    theta: Array
    rotation: Array
    log_scale: Array
    translation: Array

    def moved(self, step: Array) -> State:
        """The state after a step (N, K + 4) of weights, rotation vector and log scale."""
        k = self.theta.shape[1]
        return State(
            self.theta + step[:, :k],
            small_rotation(step[:, k : k + 3]) @ self.rotation,
            self.log_scale + np.clip(step[:, k + 3], -1, 1),
            self.translation,
        )

    def take(self, frames: NDArray[np.intp]) -> State:
        """The state of these frames."""
        return State(self.theta[frames], self.rotation[frames], self.log_scale[frames], self.translation[frames])

    def truncated(self, k: int) -> State:
        """The state without the weights after the first `k`."""
        return replace(self, theta=self.theta[:, :k])

    def with_first(self, other: State) -> State:
        """The other state, its missing weights from this one."""
        k = other.theta.shape[1]
        return replace(other, theta=np.concatenate([other.theta, self.theta[:, k:]], axis=1))

    def where(self, take: NDArray[np.bool_], other: State) -> State:
        """This state in the frames where `take` (N,), the other elsewhere."""
        return State(
            np.where(take[:, None], self.theta, other.theta),
            np.where(take[:, None, None], self.rotation, other.rotation),
            np.where(take, self.log_scale, other.log_scale),
            np.where(take[:, None], self.translation, other.translation),
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """A state, and how it fits the image.

    Attributes:
        turned: (N, J, 3) m, scaled poses in the camera frame.
        depth: (N, J) of a joint over that of the body's origin.
        error: (N, J, 2) m, reprojection errors.
        squared: (N, J) m^2, their squares.
        bones: (N, B, 3) unit vectors in the body frame; length: (N, B) m.
        excess: (N, B) m, of the lengths over their sequence's mean; means: (P, B) m.
        turning: (N, 9) m's six elements, two of the vertical's image, and the log scale.
    """

    state: State
    turned: Array
    depth: Array
    error: Array
    squared: Array
    bones: Array
    length: Array
    excess: Array
    means: Array
    turning: Array


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton's equations of a batch, the translations eliminated.

    Attributes:
        diagonal: (N, n, n) blocks of the frames; coupling: those between them.
        gradient: (N, n), halved like the matrix.
        data: (N, 2 J, n) Jacobian of the reprojection, weighted.
        bones: (N, n, B) gradients of the bone lengths times the root of their weights.
    """

    data: Array
    diagonal: Array
    coupling: Coupling
    gradient: Array
    bones: Array

    def frozen(self, frames: NDArray[np.bool_], old: NormalEquations) -> NormalEquations:
        """These with the old matrices in the given frames (N,), all or none of a sequence."""
        if frames.any():
            for new, before in ((self.data, old.data), (self.diagonal, old.diagonal)):
                new[frames] = before[frames]
            for new, before in zip(vars(self.coupling).values(), vars(old.coupling).values(), strict=True):
                new[frames[:-1]] = before[frames[:-1]]
        return self
