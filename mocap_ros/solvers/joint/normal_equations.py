"""The normal equations of a Gauss-Newton step, and how the terms of the objective add to them.

A step x solves

    (A - sum_p sum_b g_pb g_pb^T / F_p) x = -g

where A is block tridiagonal, with one n x n block a frame and couplings between neighbouring frames; the low-rank
part comes from the mean bone lengths of each sequence p, which are eliminated exactly (`bone_lengths`). The
translations are eliminated within each frame (`reprojection`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.solvers.block_banded import Coupling

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The equations of a batch; terms add to the arrays in place while the equations are built.

    Attributes:
        data: (N, 2 J, n) weighted Jacobian of the reprojection, by which the noise estimate counts the unknowns.
        diagonal: (N, n, n) diagonal blocks of A.
        coupling: blocks of A between neighbouring frames.
        gradient: (N, n) half the gradient of the objective.
        bones: (N, n, B) the vectors g of the mean bone lengths.
    """

    data: Array
    diagonal: Array
    coupling: Coupling
    gradient: Array
    bones: Array

    @staticmethod
    def from_rows(residual: Array, jacobian: Array, bones: int, camera_unknowns: int) -> NormalEquations:
        """InitialValues with the reprojection; couplings and low-rank part are still zero.

        Args:
            residual: (N, 2 J) weighted reprojection errors, translations eliminated.
            jacobian: (N, 2 J, n) their derivatives by the unknowns of their own frame.
            bones: number of bones B.
            camera_unknowns: number of unknowns of a camera, the last ones of each frame.
        """
        transposed = np.swapaxes(jacobian, -1, -2)
        frames, _, n = jacobian.shape
        corner = np.zeros((frames - 1, camera_unknowns, camera_unknowns))
        return NormalEquations(
            data=jacobian,
            diagonal=transposed @ jacobian,
            coupling=Coupling(np.zeros((frames - 1, n)), corner),
            gradient=(transposed @ residual[..., None])[..., 0],
            bones=np.zeros((frames, n, bones)),
        )

    def add_rows(self, residual: Array, jacobian: Array) -> None:
        """Add a sum of squares within each frame, in place.

        Args:
            residual: (N, R) residuals, each times the root of its weight.
            jacobian: (N, R, n) their derivatives by the unknowns of their own frame, weighted likewise.
        """
        transposed = np.swapaxes(jacobian, -1, -2)
        self.diagonal[:] += transposed @ jacobian
        self.gradient[:] += (transposed @ residual[..., None])[..., 0]

    def with_frozen(self, frames: NDArray[np.bool_], old: NormalEquations) -> NormalEquations:
        """Put the matrices of the old equations into the frames (N,) of sequences that have converged.

        Their factorisation then stays that of the step with which they converged.
        """
        if frames.any():
            for new, before in ((self.data, old.data), (self.diagonal, old.diagonal)):
                new[frames] = before[frames]
            for new, before in (
                (self.coupling.diagonal, old.coupling.diagonal),
                (self.coupling.corner, old.coupling.corner),
            ):
                new[frames[:-1]] = before[frames[:-1]]
        return self
