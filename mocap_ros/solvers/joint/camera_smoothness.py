"""The smoothness of the camera over time: the flip regulariser (TPAMI 2016, eq. 12), tilt and scale.

    gamma sum_t |M_t - M_(t-1)|^2 / dt_t           flip regulariser: M_t = s_t R_t[:2], the paper's matrix of the
    camera
  + tau   sum_t |R_t[:2] z - R_(t-1)[:2] z|^2 / dt_t   tilt: the image of the vertical z changes slowly
  + sigma sum_t (log s_t - log s_(t-1))^2 / dt_t   scale: people come nearer slowly

All three are weighted squared changes of nine features of a frame's camera: for each of the two image axes the
three elements of M and the vertical's image, then the logarithm of the scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, fill_camera_jacobian
from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.state import Fit, State

Array = NDArray[np.float64]

FEATURES = 9  # two rows of M with the image of the vertical (4 + 4), and the logarithm of the scale
VERTICAL_FEATURES = [3, 7]  # index of the image of the vertical, x and y
LOG_SCALE_FEATURE = 8  # the last of them


def camera_features(state: State) -> Array:
    """(N, 9) the features of the cameras of a state."""
    scale = np.exp(state.log_scale)[:, None, None]
    out = np.empty((len(state.theta), FEATURES))
    out[:, [0, 1, 2]], out[:, [4, 5, 6]] = np.moveaxis(scale * state.rotation[:, :2], 1, 0)
    out[:, VERTICAL_FEATURES], out[:, LOG_SCALE_FEATURE] = state.rotation[:, :2, 2], state.log_scale
    return out


@dataclass(frozen=True, eq=False)
class CameraSmoothness:
    """The term of a batch.

    Attributes:
        weight: (N - 1, 9) weights of the squared changes of the features, 0 between two sequences.
    """

    weight: Array

    @staticmethod
    def build(inverse_time_steps: Array, flip: float, tilt: float, scale: float) -> CameraSmoothness:
        """Return the term of these weights gamma, tau and sigma; inverse_time_steps (N - 1,) 1/s."""
        return CameraSmoothness(inverse_time_steps[:, None] * ([*[flip] * 3, tilt] * 2 + [scale]))

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of each pair of neighbours, counted for the earlier frame."""
        features = fit.camera_features
        cost = np.zeros(len(features))
        cost[:-1] = np.einsum('nc,nc->n', self.weight, (features[1:] - features[:-1]) ** 2)
        return cost

    def add_to(self, equations: NormalEquations, fit: Fit) -> None:
        """Add the matrix, the coupling of neighbouring cameras and the gradient, in place."""
        frames, k = fit.state.theta.shape
        columns = np.swapaxes(fit.state.rotation, -1, -2)
        points = np.empty((frames, 4, 3))
        points[:, :3] = np.exp(fit.state.log_scale)[:, None, None] * columns
        points[:, 3] = columns[:, 2]
        jacobian = np.zeros((frames, FEATURES, CAMERA_UNKNOWNS))
        of_columns = jacobian[:, :8].reshape(frames, 2, 4, CAMERA_UNKNOWNS)
        fill_camera_jacobian(np.swapaxes(of_columns, 1, 2), points)
        jacobian[:, VERTICAL_FEATURES, 3] = 0.0
        jacobian[:, LOG_SCALE_FEATURE, 3] = 1.0
        weight = self.weight[..., None]
        transposed = np.swapaxes(jacobian, -1, -2)
        stiffness = np.zeros((frames, FEATURES, 1))
        stiffness[:-1] += weight
        stiffness[1:] += weight
        equations.diagonal[:, k:, k:] += transposed @ (stiffness * jacobian)
        equations.coupling.corner[:] -= transposed[1:] @ (weight * jacobian[:-1])
        pull = weight * (fit.camera_features[1:] - fit.camera_features[:-1])[..., None]
        equations.gradient[1:, k:] += (transposed[1:] @ pull)[..., 0]
        equations.gradient[:-1, k:] -= (transposed[:-1] @ pull)[..., 0]

    def subsampled(self, kept: Subsample) -> CameraSmoothness:
        """Return the term of some frames only."""
        return replace(self, weight=self.weight[kept.pairs] * kept.pair_factor[:, None])

    def with_components(self, k: int) -> CameraSmoothness:  # noqa: ARG002, part of the protocol
        """Return the term itself, which does not depend on the base poses."""
        return self
