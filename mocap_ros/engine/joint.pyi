# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
Field: TypeAlias = Literal[
    'theta', 'features', 'rotation', 'log_scale', 'translation', 'scaled_pose', 'depth', 'error', 'squared',
    'direction', 'length', 'excess',
]  # fmt: skip

class JointProblem:
    """The objectives of P sequences with N frames in all, a point, and what Levenberg-Marquardt needs.

    Arrays are C-contiguous; the arguments are those of `solvers.joint.objective.JointObjective` and its batch,
    with the T differences as `orders` (T,), `factors` (T, N, 3) and `feature_weight` (T, K + 13).

    Attributes:
        diagonal: (N, n, n) blocks of the normal equations; only their lower triangles are written.
        gradient: (N, n) half the gradient.
        bone_vectors: (N, n, B) G.
        coupling: (N, D, n) diagonals of the blocks in the rows of frame t + d + 1 and the columns of frame t.
        corners: (N, D, 4, 4) what is added to these in the rows and columns of the cameras.
        cost: (P,) m^2.
        damping: (P,) of the next step of each sequence.
        iterations: (P,) number of steps that were tried.
        status: (P,) `SolverStatus`.
        is_done: (P,).
    """

    diagonal: Array
    gradient: Array
    bone_vectors: Array
    coupling: Array
    corners: Array
    cost: Array
    damping: Array
    iterations: Ints
    status: Ints
    is_done: Bools

    def __init__(
        self,
        *,
        starts: Ints,
        counts: Ints,
        is_free: Bools,
        image: Array,
        score: Array,
        focal: Array,
        lifted: Array,
        precision: Array,
        earlier_lengths: Array,
        earlier_frames: Ints,
        noise_ratio: Array,
        mean: Array,
        basis: Array,
        bones: Array,
        parents: Ints,
        children: Ints,
        robust_scale: float,
        bone_weight: Array,
        prior: Array,
        lifter_weight: float,
        lifter_robust_scale: float,
        orders: Ints,
        factors: Array,
        feature_weight: Array,
    ) -> None: ...
    def start(
        self,
        theta: Array,
        rotation: Array,
        log_scale: Array,
        translation: Array,
        settle_steps: int = 0,
        at_reference: bool = False,
    ) -> None:
        """Set the point.

        Args:
            theta: (N, K) m.
            rotation: (N, 3, 3).
            log_scale: (N,).
            translation: (N, 2) m.
            settle_steps: number of steps of the robust fit by which the translations settle.
            at_reference: whether they settle under the robust scale of the reference noise.
        """

    def begin(self, damping: float) -> None:
        """Set the damping of the first step of all sequences, and compute the normal equations."""

    def update_equations(self) -> None:
        """Compute the normal equations of the sequences that have moved and are not done."""

    def try_steps(self, tolerance: float) -> tuple[int, int]:
        """Try a step of each sequence; return how many were taken, and how many sequences are not done."""

    def estimate_noise(self) -> Array:
        """Return the image noise (P,) m of a coordinate of a point of weight 1, from the residuals."""

    def measure_joint_std(self) -> Array:
        """Return the posterior standard deviations (P, J) m of the last joints about the body's origin.

        They are roots of the traces of their covariances; NaN where no step could be computed.
        """

    def read(self, name: Field) -> Array:
        """Return a quantity (N, ...) of all frames at the current point."""

def fit_lifted_poses(
    joints: Array, std: Array, basis: Array, mean: Array, sigma: Array, alternations: int
) -> tuple[Array, Array, Array]:
    """Return weights (F, K), scales (F,) and rotations (F, 3, 3) that fit lifted poses (F, J, 3) of this std.

    Args:
        joints: lifted poses, all known.
        std: their standard deviations.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
        mean: (J, 3) m, mean pose.
        sigma: (K,) m, standard deviations of the weights.
        alternations: rounds of cameras and weights.
    """
