"""The reprojection term, robust and in perspective where the focal length is known (TPAMI 2016, eq. 9).

    sum_tj w_tj rho(|e_tj|^2) / v_t,    e_tj = (s_t R_t[:2] P_tj + t_t) / d_tj - x_tj / s0,
    d_tj = 1 + s_t R_t[2] P_tj / f,     rho(a) = c^2 log(1 + a / c^2)  (Cauchy's loss; c infinite: least squares)

with x_tj the image point in px, s0 the sequence's unit in px/m, f the focal length in that unit (infinite under
weak perspective, where d = 1), w_tj the detector's score, and v_t the variance of the image noise over that of the
reference (10 mm). So image errors are metres at the body.

The translation t_t is never an unknown of the step: given the others, the optimum makes all errors relative to
their weighted mean, and the rows of the normal equations are those of the errors less that mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, fill_camera_jacobian
from mocap_ros.solvers.joint.batch import Subsample
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

MIN_DEPTH = 0.1  # of the depth of the body's origin; a joint nearer to the camera than that is a failed solution
MIN_ROBUST_SCALE = 1e-6  # m; a smaller `robust_scale` selects least squares
MIN_TOTAL_WEIGHT = 1e-12  # guards the division by the weights of a frame in which no joint is seen


@dataclass(frozen=True, eq=False)
class Reprojection:
    """The term of a batch.

    Attributes:
        image: (N, J, 2) m, image points in the sequence's unit.
        weight: (N, J) detector scores over `variance_ratio`.
        variance_ratio: (N,) variance of the image noise over that of the reference.
        robust_scale: (N, 1) m, scale c of Cauchy's loss; infinite for least squares.
        focal: (N, 1) focal length in the sequence's unit (m); infinite for weak perspective.
    """

    image: Array
    weight: Array
    variance_ratio: Array
    robust_scale: Array
    focal: Array

    @staticmethod
    def build(windows: Sequence[Window], units: Array, config: SolverConfig) -> Reprojection:
        """Return the term of these windows, each divided by its unit (P,) px/m; the noise is the reference's."""
        counts = [len(w.times) for w in windows]
        frames = sum(counts)
        robust = config.robust_scale if config.robust_scale > MIN_ROBUST_SCALE else np.inf
        return Reprojection(
            image=np.concatenate([w.points / unit for w, unit in zip(windows, units, strict=True)]),
            weight=np.concatenate([w.weight for w in windows]),
            variance_ratio=np.ones(frames),
            robust_scale=np.full((frames, 1), robust),
            focal=np.repeat([w.focal / unit for w, unit in zip(windows, units, strict=True)], counts)[:, None],
        )

    def subsampled(self, kept: Subsample) -> Reprojection:
        """Return the term of some frames only."""
        frames = kept.frames
        return Reprojection(
            self.image[frames],
            self.weight[frames],
            self.variance_ratio[frames],
            self.robust_scale[frames],
            self.focal[frames],
        )

    def with_variance_ratio(self, ratio: Array) -> Reprojection:
        """Return the term under another image noise.

        The scale of the robust loss grows with noise above the reference, and never shrinks.

        Args:
            ratio: (N,) standard deviation of the noise over that of the reference.
        """
        old = np.sqrt(self.variance_ratio)
        return replace(
            self,
            weight=self.weight * (self.variance_ratio / ratio**2)[:, None],
            variance_ratio=ratio**2,
            robust_scale=self.robust_scale * (np.maximum(ratio, 1) / np.maximum(old, 1))[:, None],
        )

    def depth_and_error(self, scaled_poses: Array, translation: Array) -> tuple[Array, Array]:
        """Return the relative depths (N, J) and the errors (N, J, 2) m of scaled poses (N, J, 3)."""
        depth = np.maximum(1 + scaled_poses[..., 2] / self.focal, MIN_DEPTH)
        error = (scaled_poses[..., :2] + translation[:, None]) / depth[..., None] - self.image
        return depth, error

    def optimal_shift(self, fit: Fit) -> Array:
        """(N, 2) m, change that brings each translation to its weighted optimum (one step of the robust fit)."""
        weight = self._robust_weight(fit) / fit.depth
        total = np.maximum((weight / fit.depth).sum(axis=1), MIN_TOTAL_WEIGHT)[:, None]
        return np.asarray(-np.einsum('nj,njd->nd', weight, fit.error) / total)

    def centroids(self) -> Array:
        """(N, 2) m, weighted centroids of the image points."""
        total = np.maximum(self.weight.sum(axis=1), MIN_TOTAL_WEIGHT)[:, None]
        return np.asarray((self.weight[..., None] * self.image).sum(axis=1) / total)

    def loss(self, fit: Fit) -> Array:
        """(N, J) m^2, rho of the squared errors."""
        if np.isinf(self.robust_scale[0, 0]):
            return fit.squared_error
        return np.asarray(self.robust_scale**2 * np.log1p(fit.squared_error / self.robust_scale**2))

    def cost(self, fit: Fit) -> Array:
        """(N,) m^2, value of the term in each frame."""
        return np.asarray(np.einsum('nj,nj->n', self.weight, self.loss(fit)))

    def rows(self, fit: Fit) -> tuple[Array, Array]:
        """Return the weighted errors (N, 2 J) and their derivatives (N, 2 J, n), translations eliminated."""
        frames, joints = fit.squared_error.shape
        jacobian = self._jacobian(fit)
        residual = np.swapaxes(fit.depth[..., None] * fit.error, 1, 2)  # (N, 2, J)
        weight = self._robust_weight(fit) / fit.depth**2
        share = (weight / np.maximum(weight.sum(axis=1), MIN_TOTAL_WEIGHT)[:, None])[:, None]
        root = np.sqrt(weight)[:, None]
        jacobian -= share[:, :, None] @ jacobian
        jacobian *= root[..., None]
        residual = root * (residual - (share * residual).sum(axis=2, keepdims=True))
        return residual.reshape(frames, -1), jacobian.reshape(frames, 2 * joints, -1)

    def _robust_weight(self, fit: Fit) -> Array:
        """(N, J) weights of the squared errors in the quadratic approximation of the robust loss."""
        return np.asarray(self.weight / (1 + fit.squared_error / self.robust_scale**2))

    def _jacobian(self, fit: Fit) -> Array:
        """(N, 2, J, n) derivatives of the image points by the unknowns, times each joint's depth."""
        state, scaled_poses = fit.state, fit.scaled_poses
        frames, k = state.theta.shape
        joints = scaled_poses.shape[1]
        basis = np.moveaxis(fit.model.components, 0, -1)  # (J, 3, K)
        perspective = bool(np.isfinite(self.focal).any())
        rows = 3 if perspective else 2
        camera = np.exp(state.log_scale)[:, None, None] * state.rotation[:, :rows]
        flat = np.swapaxes(basis, 0, 1).reshape(3, -1)
        jacobian = np.empty((frames, rows, joints, k + CAMERA_UNKNOWNS))
        jacobian[..., :k] = (camera.reshape(-1, 3) @ flat).reshape(frames, rows, joints, k)
        fill_camera_jacobian(np.swapaxes(jacobian[..., k:], 1, 2), scaled_poses)
        if not perspective:
            return jacobian
        inward = np.swapaxes((fit.error + self.image) / self.focal[..., None], 1, 2)[..., None]
        return np.asarray(jacobian[:, :2] - inward * jacobian[:, 2:])
