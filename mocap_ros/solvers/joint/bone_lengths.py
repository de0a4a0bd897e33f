# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

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
from numba import types, void
from numpy.typing import NDArray

from mocap_ros.compiled.blas import add_transposed_product
from mocap_ros.compiled.kernel import BOOLS_1D, FLOATS_1D, FLOATS_2D, FLOATS_3D, INTS_1D, kernel
from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses, arrange_model
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
        strength: (P,) reciprocal number of frames over which the mean lengths of each sequence are taken.
        flat_bones: (3 B, K) change of the vectors along the bones with the weights; a coordinate of a bone in each
            row.
    """

    batch: Batch
    weight: Array
    parents: NDArray[np.intp]
    children: NDArray[np.intp]
    earlier_lengths: Array
    earlier_frames: NDArray[np.intp]
    strength: Array
    flat_bones: Array

    @staticmethod
    def build(batch: Batch, windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> BoneLengths:
        """Return the term of these windows."""
        earlier = [w.earlier_frames for w in windows]
        arrays = arrange_model(model)
        mean_lengths = arrays.mean_bone_lengths
        earlier_frames = np.array([0 if e is None else e.count for e in earlier])
        return BoneLengths(
            batch=batch,
            weight=np.full(len(mean_lengths), config.bone_weight),
            parents=arrays.parents,
            children=arrays.children,
            earlier_lengths=np.array([mean_lengths if e is None else e.mean_bone_lengths for e in earlier]),
            earlier_frames=earlier_frames,
            strength=1 / (batch.counts + earlier_frames),
            flat_bones=arrays.bones,
        )

    def measure(self, poses: Array) -> tuple[Array, Array, Array, Array]:
        """Return the bones of poses (N, J, 3) m as `Fit` holds them: direction, length, excess and mean length."""
        batch = self.batch
        return _measure_bones(
            poses,
            self.parents,
            self.children,
            batch.starts,
            batch.counts,
            self.earlier_lengths,
            self.earlier_frames,
        )

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value in each frame; that of the frames before a window counts for its first frame."""
        return _sum_excess(
            self.weight,
            fit.bone_excess,
            fit.mean_bone_length,
            self.batch.starts,
            self.earlier_lengths,
            self.earlier_frames,
        )

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the gradient, and the vectors of the low-rank part, in place."""
        _add_bones(
            self.weight,
            self.flat_bones,
            equations.is_active,
            fit.bone_direction,
            fit.bone_length,
            fit.bone_excess,
            equations.bones,
            equations.diagonal,
            equations.gradient,
        )

    def subsampled(self, kept: Subsample) -> BoneLengths:
        """Return the term of some frames only."""
        return replace(self, batch=kept.batch, strength=1 / (kept.batch.counts + self.earlier_frames))

    def with_components(self, k: int) -> BoneLengths:
        """Return the term for the first `k` base poses."""
        return replace(self, flat_bones=np.ascontiguousarray(self.flat_bones[:, :k]))


@kernel(
    types.Tuple((FLOATS_3D, FLOATS_2D, FLOATS_2D, FLOATS_2D))(
        FLOATS_3D, INTS_1D, INTS_1D, INTS_1D, INTS_1D, FLOATS_2D, INTS_1D
    )
)
def _measure_bones(
    poses: Array,
    parents: NDArray[np.intp],
    children: NDArray[np.intp],
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
    earlier_lengths: Array,
    earlier_frames: NDArray[np.intp],
) -> tuple[Array, Array, Array, Array]:
    """Return direction (N, B, 3), length (N, B), excess (N, B) and mean length (P, B) of the bones of poses."""
    frames, bones, sequences = len(poses), len(parents), len(starts)
    direction = np.empty((frames, bones, 3))
    length, excess = np.empty((frames, bones)), np.empty((frames, bones))
    mean = np.empty((sequences, bones))
    for t in range(frames):
        for b in range(bones):
            x = poses[t, children[b], 0] - poses[t, parents[b], 0]
            y = poses[t, children[b], 1] - poses[t, parents[b], 1]
            z = poses[t, children[b], 2] - poses[t, parents[b], 2]
            length[t, b] = max(np.sqrt(x * x + y * y + z * z), MIN_LENGTH)
            direction[t, b, 0] = x / length[t, b]
            direction[t, b, 1] = y / length[t, b]
            direction[t, b, 2] = z / length[t, b]
    for p in range(sequences):
        own = range(starts[p], starts[p] + counts[p])
        for b in range(bones):
            total = earlier_frames[p] * earlier_lengths[p, b]
            for t in own:
                total += length[t, b]
            mean[p, b] = total / (counts[p] + earlier_frames[p])
            for t in own:
                excess[t, b] = length[t, b] - mean[p, b]
    return direction, length, excess, mean


@kernel(FLOATS_1D(FLOATS_1D, FLOATS_2D, FLOATS_2D, INTS_1D, FLOATS_2D, INTS_1D))
def _sum_excess(
    weight: Array,
    excess: Array,
    mean: Array,
    starts: NDArray[np.intp],
    earlier_lengths: Array,
    earlier_frames: NDArray[np.intp],
) -> Array:
    """Return the value of the term in each frame (N,), with that of the earlier frames in the first ones."""
    out = np.zeros(len(excess))
    for t in range(len(excess)):
        for b in range(len(weight)):
            out[t] += weight[b] * excess[t, b] * excess[t, b]
    for p in range(len(starts)):
        for b in range(len(weight)):
            change = mean[p, b] - earlier_lengths[p, b]
            out[starts[p]] += earlier_frames[p] * weight[b] * change * change
    return out


@kernel(void(FLOATS_1D, FLOATS_2D, BOOLS_1D, FLOATS_3D, FLOATS_2D, FLOATS_2D, FLOATS_3D, FLOATS_3D, FLOATS_2D))
def _add_bones(
    weight: Array,
    flat_bones: Array,
    is_active: NDArray[np.bool_],
    direction: Array,
    length: Array,
    excess: Array,
    bones: Array,
    diagonal: Array,
    gradient: Array,
) -> None:
    """Add the term to the diagonal blocks and the gradient, and write the vectors of the low-rank part.

    With D_b (3, K) the Jacobian of the vector along bone b, u_b its direction and c_b the second derivative by its
    length that is put in (head of this module), the matrix is sum_b D_b^T ((w_b - c_b) u_b u_b^T + c_b I) D_b.
    """
    frames, count, _ = direction.shape
    k = flat_bones.shape[1]
    weighted = np.empty((3 * count, k))
    for t in range(frames):
        if not is_active[t]:
            continue
        for b in range(count):
            u = direction[t, b]
            curvature = weight[b] * max(excess[t, b] / length[t, b], 0.0)
            root, pull = np.sqrt(weight[b]), weight[b] * excess[t, b]
            for i in range(k):
                x, y, z = flat_bones[3 * b, i], flat_bones[3 * b + 1, i], flat_bones[3 * b + 2, i]
                along = u[0] * x + u[1] * y + u[2] * z
                bones[t, i, b] = root * along
                gradient[t, i] += pull * along
                stretched = (weight[b] - curvature) * along
                weighted[3 * b, i] = stretched * u[0] + curvature * x
                weighted[3 * b + 1, i] = stretched * u[1] + curvature * y
                weighted[3 * b + 2, i] = stretched * u[2] + curvature * z
        matrix = np.zeros((k, k))
        add_transposed_product(1.0, flat_bones, weighted, matrix)
        diagonal[t, :k, :k] += matrix
