"""The objective of the joint solver: the reprojection and a list of further terms, a file each.

    E = reprojection (eq. 9) + bone lengths (eq. 20) + base-pose prior + smoothness of the weights
      + smoothness of the camera (eq. 12) + lifted poses, where there are any

over all frames of a batch at once. The weights of all terms but the first are given for an image noise of 10 mm
(`NOISE_REFERENCE`). Under another noise, which is found from the residual in a few rounds, the reprojection is
divided by the ratio of the variances, as the maximum of the posterior demands.

A frame has K weights, three rotation parameters and the logarithm of a scale as unknowns; its translation is
eliminated. The normal matrix is block tridiagonal, the mean bone lengths are eliminated exactly by a low-rank
correction, and the sequences of a batch are not coupled with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.camera_jacobian import CAMERA_UNKNOWNS, fill_rotation_jacobian
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.block_banded import BandedCholesky, factorise_banded, solve_low_rank_downdate
from mocap_ros.solvers.joint.base_pose_prior import BasePosePrior
from mocap_ros.solvers.joint.batch import Batch, Subsample
from mocap_ros.solvers.joint.bone_lengths import BoneLengths
from mocap_ros.solvers.joint.camera_smoothness import CameraSmoothness, camera_features
from mocap_ros.solvers.joint.lifted_pose import LiftedPoseTerm
from mocap_ros.solvers.joint.normal_equations import NormalEquations
from mocap_ros.solvers.joint.pose_smoothness import PoseSmoothness
from mocap_ros.solvers.joint.reprojection import Reprojection
from mocap_ros.solvers.joint.state import Fit, State
from mocap_ros.solvers.joint.term import Term
from mocap_ros.solvers.window import InitialValues, Window

Array = NDArray[np.float64]
AnyTerm = TypeVar('AnyTerm')

NOISE_REFERENCE = 0.01  # m; image noise at the body for which the weights in the configuration are given
FIXED_STIFFNESS = (
    1e9  # m^2; stiffness of the unknowns of frames that keep their initial values: far above any real one
)
MIN_DIAGONAL = 1e-12  # added to the diagonal, for unknowns on which nothing depends (a frame without seen joints)
MIN_FREE_SHARE = (
    0.05  # of the coordinates; where the unknowns fit nearly all of them, so many still measure the noise
)
NOISE_FRAMES = 3  # frames of a sequence, at least, in which the unknowns that the fit absorbs are counted
NOISE_FRAME_STEP = 15  # frames; of a longer sequence one further frame in so many is counted


@dataclass(frozen=True, eq=False)
class JointObjective:
    """The objective of a batch of sequences.

    Attributes:
        model: base poses.
        batch: which frames belong to which sequence.
        reprojection: the term of the image points.
        bones: the term of the bone lengths.
        terms: all further terms, the bone lengths included.
        fixed: (N,) True for frames that keep their initial values.
    """

    model: BasePoses
    batch: Batch
    reprojection: Reprojection
    bones: BoneLengths
    terms: tuple[Term, ...]
    fixed: NDArray[np.bool_]

    @staticmethod
    def build(windows: Sequence[Window], units: Array, model: BasePoses, config: SolverConfig) -> JointObjective:
        """Return the objective of these windows.

        Args:
            windows: the sequences.
            units: (P,) px/m, by which the image points of each window are divided.
            model: base poses, metric.
            config: weights of the terms.

        Raises:
            InputError: only some of the windows have lifted poses.
        """
        batch = Batch.of_times([w.times for w in windows])
        lifted = LiftedPoseTerm.build(windows, units, config)
        prior, smooth, flip, tilt = config.prior_weight, config.smooth_weight, config.flip_weight, 0.0
        if model.aligned_by_heading:
            prior, flip = config.heading_prior_factor * prior, config.heading_flip_factor * flip
            tilt = config.tilt_weight
        if lifted is not None:
            prior, smooth = config.lifter_prior_factor * prior, config.lifter_smooth_factor * smooth
            flip = config.lifter_flip_factor * flip
        bones = BoneLengths.build(batch, windows, model, config)
        terms: list[Term] = [
            bones,
            BasePosePrior(prior / model.std**2),
            PoseSmoothness(smooth * batch.inverse_time_steps),
            CameraSmoothness.build(batch.inverse_time_steps, flip, tilt, config.scale_weight),
        ]
        if lifted is not None:
            terms.append(lifted)
        return JointObjective(
            model=model,
            batch=batch,
            reprojection=Reprojection.build(windows, units, config),
            bones=bones,
            terms=tuple(terms),
            fixed=np.concatenate([np.arange(len(w.times)) < w.fixed_frames for w in windows]),
        )

    def find_term(self, kind: type[AnyTerm]) -> AnyTerm:
        """Return the term of a class; raises StopIteration where there is none."""
        return next(term for term in self.terms if isinstance(term, kind))

    def with_components(self, k: int) -> JointObjective:
        """Return the objective with the first `k` base poses."""
        terms = tuple(term.with_components(k) for term in self.terms)
        return replace(self, model=self.model.truncate(k), terms=terms)

    def subsampled(self, step: float) -> tuple[JointObjective, Subsample]:
        """Return the objective of the best-seen frame of every `step` s, and which frames those are."""
        kept = self.batch.subsample(step, self.reprojection.weight.sum(axis=1))
        bones = self.bones.subsampled(kept)
        objective = replace(
            self,
            batch=kept.batch,
            reprojection=self.reprojection.subsampled(kept),
            bones=bones,
            terms=tuple(bones if term is self.bones else term.subsampled(kept) for term in self.terms),
            fixed=self.fixed[kept.frames],
        )
        return objective, kept

    def with_noise(self, noise: Array) -> JointObjective:
        """Return the objective under image noise of these standard deviations (P,) m, one a sequence."""
        ratio = self.batch.repeat_per_frame(noise / NOISE_REFERENCE)
        return replace(self, reprojection=self.reprojection.with_variance_ratio(ratio))

    def estimate_noise(self, fit: Fit, equations: NormalEquations) -> Array:
        """(P,) m, standard deviation of a coordinate of an image point with score 1, from the residual.

        The sum of squares is shared among the coordinates, less those that the unknowns have absorbed while their
        neighbours are held.

        Args:
            fit: of the state at hand.
            equations: of that state or of one nearby.
        """
        weight, ratio = self.reprojection.weight, self.reprojection.variance_ratio
        loss = ratio[:, None] * weight * self.reprojection.loss(fit)
        coordinates = 2 * self.batch.sum_per_sequence((weight > 0).sum(axis=1))
        free = np.maximum(coordinates - self._absorbed(equations), MIN_FREE_SHARE * coordinates + 1)
        return np.sqrt(self.batch.sum_per_sequence(loss.sum(axis=1)) / free)

    def _absorbed(self, equations: NormalEquations) -> Array:
        """(P,) number of coordinates that the unknowns fit away, extrapolated from some frames of a sequence."""
        counts, starts = self.batch.counts, self.batch.starts
        stride = -(-counts // (NOISE_FRAMES + counts // NOISE_FRAME_STEP))
        number = np.arange(len(self.fixed)) - self.batch.repeat_per_frame(starts)
        frames = np.flatnonzero(number % self.batch.repeat_per_frame(stride) == 0)
        examined = -(-counts // stride)
        block = equations.diagonal[frames] + 1e-9 * np.eye(equations.diagonal.shape[1])
        data = np.swapaxes(equations.data[frames], -1, -2)
        absorbed = 2 + (data * np.linalg.solve(block, data)).sum(axis=(1, 2))
        return np.add.reduceat(absorbed, np.cumsum(examined) - examined) * (counts / examined)

    def fit(self, state: State) -> Fit:
        """Return what the terms measure in a state."""
        poses = self.model.poses(state.theta)
        scale = np.exp(state.log_scale)[:, None, None]
        scaled_poses = scale * (poses @ np.swapaxes(state.rotation, -1, -2))
        depth, error = self.reprojection.depth_and_error(scaled_poses, state.translation)
        direction, length, excess, mean = self.bones.measure(poses)
        return Fit(
            state=state,
            model=self.model,
            scaled_poses=scaled_poses,
            depth=depth,
            error=error,
            squared_error=np.einsum('njd,njd->nj', error, error),
            bone_direction=direction,
            bone_length=length,
            bone_excess=excess,
            mean_bone_length=mean,
            camera_features=camera_features(state),
        )

    def with_optimal_translation(self, state: State) -> Fit:
        """Return the fit of the state with each translation at its optimum (one step of the robust fit)."""
        fit = self.fit(state)
        shift = self.reprojection.optimal_shift(fit)
        error = fit.error + shift[:, None] / fit.depth[..., None]
        return replace(
            fit,
            state=replace(state, translation=state.translation + shift),
            error=error,
            squared_error=np.einsum('njd,njd->nj', error, error),
        )

    def cost(self, fit: Fit) -> Array:
        """(P,) m^2, value of the objective of each sequence."""
        per_frame = self.reprojection.cost(fit)
        for term in self.terms:
            per_frame += term.cost(fit)
        return self.batch.sum_per_sequence(per_frame)

    def normal_equations(self, fit: Fit) -> NormalEquations:
        """Return the equations of a Gauss-Newton step."""
        residual, jacobian = self.reprojection.rows(fit)
        equations = NormalEquations.from_rows(residual, jacobian, len(self.bones.weight), CAMERA_UNKNOWNS)
        for term in self.terms:
            term.add_to(equations, fit)
        return equations

    def step(self, equations: NormalEquations, damping: Array) -> tuple[Array, BandedCholesky] | None:
        """Solve for a Levenberg-Marquardt step.

        Args:
            equations: of the state at hand.
            damping: (P,) relative increase of the diagonal.

        Returns:
            The step (N, n), and the factored matrix without its low-rank part; None where the matrix is not
            positive definite.
        """
        diagonal = equations.diagonal.copy()
        on_diagonal = np.einsum('nii->ni', diagonal)
        on_diagonal *= 1 + self.batch.repeat_per_frame(damping)[:, None]
        on_diagonal += MIN_DIAGONAL
        on_diagonal[self.fixed] += FIXED_STIFFNESS
        banded = factorise_banded(diagonal, equations.coupling)
        if banded is None:
            return None
        strength = 1 / self.bones.averaged_frames
        step = -solve_low_rank_downdate(banded, equations.gradient, equations.bones, strength, self.batch.starts)
        return step, banded

    def joint_std(self, fit: Fit, banded: BandedCholesky) -> Array:
        """(P, J) m, posterior standard deviation of each sequence's last joints about the body's origin.

        It is the root of the trace of each joint's covariance. The last block of a Cholesky factor is that of the
        marginal distribution of the last unknowns.
        """
        last = self.batch.starts + self.batch.counts - 1
        k = fit.state.theta.shape[1]
        inverse = np.linalg.inv(banded.diagonal_blocks(last, k + CAMERA_UNKNOWNS))
        rotation = fit.state.rotation[last]
        basis = np.swapaxes(self.model.components, 0, 1)  # (J, K, 3)
        by_theta = np.swapaxes(basis @ np.swapaxes(rotation, -1, -2)[:, None], -1, -2)
        joints = fit.scaled_poses[last] / np.exp(fit.state.log_scale[last])[:, None, None]
        jacobian = np.zeros((*joints.shape, k + CAMERA_UNKNOWNS))  # (P, J, 3, n), by the log scale 0
        jacobian[..., :k] = by_theta
        fill_rotation_jacobian(jacobian[..., k : k + 3], joints)
        whitened = jacobian @ np.swapaxes(inverse, -1, -2)[:, None]
        return np.asarray(NOISE_REFERENCE * np.sqrt((whitened**2).sum(axis=(-2, -1))))

    def initial_state(self, starts: Sequence[InitialValues], units: Array) -> State:
        """Return the state at these starts, with the translations at the centroids of the image points.

        Args:
            starts: weights and cameras of each sequence, scales in px/m.
            units: (P,) px/m, as for `build`.
        """
        theta = np.concatenate([s.theta for s in starts])
        rotation = np.concatenate([s.cameras.rotation for s in starts])
        scale = np.concatenate([s.cameras.scale / unit for s, unit in zip(starts, units, strict=True)])
        return State(theta, rotation, np.log(scale), self.reprojection.centroids())
