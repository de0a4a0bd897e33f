"""The bone-length term: the bones of a person keep their lengths (TPAMI 2016, eq. 20).

    beta sum_tb (l_tb - m_b)^2,    m_b = mean of l_tb over the sequence

with l_tb the length of bone b in frame t. The means m_b are unknowns that all frames of a sequence share. They are
eliminated exactly: with g_b the gradient of sum_t l_tb, the matrix of the term is

    beta sum_tb (grad l_tb)(grad l_tb)^T - beta / F sum_b g_b g_b^T,

whose second part has rank B and is taken care of by Woodbury's identity (`block_banded`). Frames before the
window, which are no longer solved for, take part in the mean with the lengths that they had.

The Gauss-Newton matrix leaves out the second derivatives of the lengths, and then needs several times as many
steps. Those of bones that are too long are positive semidefinite and are put in; those of bones that are too short
would make the matrix indefinite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.batch import Batch, Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

MIN_LENGTH = 1e-9  # m; guards the division by the length of a bone, far below that of any


@dataclass(frozen=True, eq=False)
class BoneLengths:
    """The term of a batch.

    Attributes:
        batch: which frames belong to which sequence.
        weight: (B,) beta of each bone.
        parents: (B,) index of each bone's inner joint.
        children: (B,) index of each bone's outer joint.
        earlier_lengths: (P, B) m, mean bone lengths of the frames before each window.
        earlier_frames: (P,) number of those frames.
    """

    batch: Batch
    weight: Array
    parents: NDArray[np.intp]
    children: NDArray[np.intp]
    earlier_lengths: Array
    earlier_frames: NDArray[np.intp]

    @staticmethod
    def build(batch: Batch, windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> BoneLengths:
        """Return the term of these windows."""
        parents, children = (np.array(side) for side in zip(*model.skeleton.bones, strict=True))
        lengths = model.skeleton.bone_lengths(model.mean)
        return BoneLengths(
            batch=batch,
            weight=np.full(len(lengths), config.bone_weight),
            parents=parents,
            children=children,
            earlier_lengths=np.array(
                [lengths if w.earlier_frames is None else w.earlier_frames.mean_bone_lengths for w in windows]
            ),
            earlier_frames=np.array([0 if w.earlier_frames is None else w.earlier_frames.count for w in windows]),
        )

    @property
    def averaged_frames(self) -> NDArray[np.intp]:
        """(P,) number of frames over which the mean lengths of each sequence are taken."""
        return np.asarray(self.batch.counts + self.earlier_frames)

    def measure(self, poses: Array) -> tuple[Array, Array, Array, Array]:
        """Return the bones of poses (N, J, 3) m as `Fit` holds them: direction, length, excess and mean length."""
        vector = poses[:, self.children] - poses[:, self.parents]
        length = np.maximum(np.sqrt(np.einsum('nbd,nbd->nb', vector, vector)), MIN_LENGTH)
        total = self.batch.sum_per_sequence(length) + self.earlier_frames[:, None] * self.earlier_lengths
        mean = total / self.averaged_frames[:, None]
        return vector / length[..., None], length, length - self.batch.repeat_per_frame(mean), mean

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value in each frame; that of the frames before a window counts for its first frame."""
        cost = fit.bone_excess**2 @ self.weight
        earlier = (fit.mean_bone_length - self.earlier_lengths) ** 2 @ self.weight
        cost[self.batch.starts] += self.earlier_frames * earlier
        return np.asarray(cost)

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the gradient, and the vectors of the low-rank part, in place."""
        frames, k = fit.state.theta.shape
        root = np.sqrt(self.weight)
        basis = np.moveaxis(fit.model.components, 0, -1)  # (J, 3, K)
        difference = basis[self.children] - basis[self.parents]  # (B, 3, K)
        by_theta = np.swapaxes(np.swapaxes(fit.bone_direction, 0, 1) @ difference, 0, 1)  # (N, B, K)
        equations.bones[:, :k] = np.swapaxes(by_theta * root[:, None], -1, -2)

        curvature = self.weight * np.maximum(fit.bone_excess / fit.bone_length, 0)
        along = by_theta * np.sqrt(self.weight - curvature)[..., None]
        squares = (np.swapaxes(difference, -1, -2) @ difference).reshape(len(difference), -1)
        block = np.swapaxes(along, -1, -2) @ along
        block += (curvature @ squares).reshape(frames, k, k)
        equations.diagonal[:, :k, :k] += block
        equations.gradient[:] += (equations.bones @ (root * fit.bone_excess)[..., None])[..., 0]

    def subsampled(self, kept: Subsample) -> BoneLengths:
        """Return the term of some frames only."""
        return replace(self, batch=kept.batch)

    def with_components(self, k: int) -> BoneLengths:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the number of base poses."""
        return self
