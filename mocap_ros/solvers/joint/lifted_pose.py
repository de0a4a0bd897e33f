"""The lifter's poses in the factorisation: where it starts, and a term of its objective.

The term is `omega sum_tjc rho_tj (turned_tjc - lifted_tjc)^2 / spread_tjc^2` over joints and camera coordinates,
`turned = s_t R_t P_tj` being the pose about the body's origin in the camera's frame: linear in the weights, free
of the translation, and under Cauchy's loss of each joint's whitened distance, so that the network proposes and
never insists. x and y of seen joints count too: the network has smoothed them over its history.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import cross_matrix, rotation_to
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import Lifted, joined
from mocap_ros.solvers.window import Start, Window

Array = NDArray[np.float64]

ROUNDS = 6
LEAST_SPREAD = 0.01


@dataclass(frozen=True, eq=False)
class LiftedTerm:
    """The lifter's poses beside those of a batch of frames.

    Attributes:
        joints: (N, J, 3) m at the body, about the mean of the joints.
        precision: (N, J, 3) 1 / m^2, inverse variances of these coordinates; 0 where nothing is known.
        weight: m^2, of the term.
        robust: standard deviations from which Cauchy's loss discounts a joint.
    """

    joints: Array
    precision: Array
    weight: float
    robust: float

    @staticmethod
    def of(windows: Sequence[Window], units: Array, config: SolverConfig) -> LiftedTerm | None:
        """The term of a batch of sequences, one after the other; None where none was lifted.

        Args:
            windows: all lifted or none; frames may be NaN.
            units: (P,) px/m, as in `Window`.
            config: weight and robustness of the term.

        Raises:
            InputError: some were lifted and some were not.
        """
        given = [w.lifted for w in windows if w.lifted is not None]
        if not given:
            return None
        if len(given) < len(windows):
            raise InputError('some windows of the batch have lifted poses and some have not')
        lifted = joined([x.times(1 / unit) for x, unit in zip(given, units, strict=True)])
        known = np.isfinite(lifted.joints)
        precision = np.where(known, 1 / np.maximum(np.where(known, lifted.spread, 1.0), LEAST_SPREAD) ** 2, 0.0)
        joints = np.where(known, lifted.joints, 0.0)
        return LiftedTerm(joints, precision, config.lifter_weight, config.lifter_robust_scale)

    def take(self, frames: NDArray[np.intp]) -> LiftedTerm:
        """The term of these frames alone."""
        return replace(self, joints=self.joints[frames], precision=self.precision[frames])

    def cost(self, turned: Array) -> Array:
        """(N,) m^2, value of the term for poses (N, J, 3) in m, scaled, in the camera's frame."""
        loss = self.robust**2 * np.log1p(self._squared(turned) / self.robust**2)
        return np.asarray(self.weight * loss.sum(axis=1))

    def _squared(self, turned: Array) -> Array:
        return np.asarray((self.precision * (turned - self.joints) ** 2).sum(axis=-1))

    def rows(self, turned: Array, scaled: Array, basis: Array) -> tuple[Array, Array]:
        """Residuals (N, 3J) and their derivatives (N, 3J, K + 4), weighted for Gauss and Newton.

        Args:
            turned: (N, J, 3) as in `cost`.
            scaled: (N, 3, 3) scale times rotation.
            basis: (J, 3, K) base poses.

        The derivatives are by the weights, a rotation vector on the camera's side and the log of the scale; half
        the gradient of the term is their transpose times the residuals.
        """
        frames, joints, _ = turned.shape
        k = basis.shape[-1]
        root = np.sqrt(self.weight * self.precision / (1 + self._squared(turned) / self.robust**2)[..., None])
        jac = np.empty((frames, joints, 3, k + 4))
        flat = np.swapaxes(basis, 0, 1).reshape(3, -1)
        by_theta = (scaled.reshape(-1, 3) @ flat).reshape(frames, 3, joints, k)
        jac[..., :k] = np.swapaxes(by_theta, 1, 2)
        jac[..., k : k + 3] = -cross_matrix(turned)
        jac[..., k + 3] = turned
        jac *= root[..., None]
        residual = root * (turned - self.joints)
        return residual.reshape(frames, -1), jac.reshape(frames, 3 * joints, k + 4)


def lifted_start(lifted: Lifted, window: Window, model: BasePoses) -> Start | None:
    """The base poses and cameras nearest to the lifted poses, frame by frame.

    Weights and cameras are found in turn: rotation and scale by Procrustes' analysis, weights by least squares
    under their prior. Frames that were not lifted take the nearest that was.

    Args:
        lifted: (F, J, 3) poses in px.
        window: the same frames.
        model: base poses, metric.

    Returns:
        None where no frame was lifted.
    """
    good = np.flatnonzero(np.isfinite(lifted.joints).all(axis=(1, 2)))
    if not len(good):
        return None
    joints, spread = lifted.joints[good], lifted.spread[good]
    k = len(model.std)
    flat = model.components.reshape(k, -1).T
    theta = np.zeros((len(good), k))
    scale = np.ones(len(good))
    rotation = np.broadcast_to(np.eye(3), (len(good), 3, 3))
    for _ in range(ROUNDS):
        poses = model.poses(theta)
        rotation = rotation_to(poses, joints)
        turned = poses @ np.swapaxes(rotation, -1, -2)
        scale = (turned * joints).sum(axis=(1, 2)) / (turned**2).sum(axis=(1, 2))
        scale = np.maximum(scale, 1e-9)
        back = (joints / scale[:, None, None]) @ rotation - model.mean
        # one variance a joint, the same along all axes of the body
        variance = np.maximum((spread / scale[:, None, None]) ** 2, LEAST_SPREAD**2).mean(axis=-1)
        weight = np.repeat(1 / variance, 3, axis=1)
        normal = np.swapaxes(flat * weight[..., None], -1, -2) @ flat + np.diag(model.std**-2.0)
        side = (weight * back.reshape(len(good), -1)) @ flat
        theta = np.linalg.solve(normal, side[..., None])[..., 0]
    nearest = np.abs(window.times[:, None] - window.times[good]).argmin(axis=1)
    return Start(theta[nearest], Cameras(scale[nearest], rotation[nearest]))
