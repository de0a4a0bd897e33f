# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of the joint solver: the reprojection and a list of further terms, a file each.

    E = reprojection (eq. 9) + bone lengths (eq. 20) + base-pose prior + smoothness of the weights
      + smoothness of the camera (eq. 12) + accelerations of both + lifted poses, where there are any

over all frames of a batch at once. The weights of all terms but the first are given for an image noise of 10 mm
(`NOISE_REFERENCE`). Under another noise, which is found from the residual in a few rounds, the reprojection is
divided by the ratio of the variances, as the maximum of the posterior demands.

A frame has K weights, three rotation parameters and the logarithm of a scale as unknowns; its translation is
eliminated. The normal matrix is block banded, the mean bone lengths are eliminated exactly by a low-rank
correction, and the sequences of a batch are not coupled with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.blas import add_product, add_product_transposed
from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, FLOATS_3D, kernel
from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses, arrange_model
from mocap_ros.solvers.block_banded import DampedSolution, solve_damped
from mocap_ros.solvers.joint.acceleration import Acceleration, measure_activity
from mocap_ros.solvers.joint.base_pose_prior import BasePosePrior
from mocap_ros.solvers.joint.batch import Batch, Subsample
from mocap_ros.solvers.joint.bone_lengths import BoneLengths
from mocap_ros.solvers.joint.camera_acceleration import (
    TYPICAL_PER_S2,
    CameraAcceleration,
    measure_directions,
)
from mocap_ros.solvers.joint.camera_smoothness import CameraSmoothness
from mocap_ros.solvers.joint.lifted_pose import LiftedPoseTerm
from mocap_ros.solvers.joint.normal_equations import NormalEquations, write_joint_jacobian
from mocap_ros.solvers.joint.pose_acceleration import TYPICAL_M_S2, PoseAcceleration
from mocap_ros.solvers.joint.pose_smoothness import PoseSmoothness
from mocap_ros.solvers.joint.reprojection import Reprojection
from mocap_ros.solvers.joint.state import Fit, State
from mocap_ros.solvers.joint.term import Term
from mocap_ros.solvers.window import InitialValues, Window

Array = NDArray[np.float64]
AnyTerm = TypeVar('AnyTerm')

NOISE_REFERENCE = 0.01  # m; image noise at the body for which the weights in the configuration are given


@dataclass(frozen=True, eq=False)
class JointObjective:
    """The objective of a batch of sequences.

    Attributes:
        model: base poses.
        batch: which frames belong to which sequence.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
        reprojection: the term of the image points.
        bones: the term of the bone lengths.
        terms: all terms, those two included.
        is_free: (N,) False for frames that keep their initial values.
        limits_accelerations: whether there are the two terms of acceleration.
    """

    model: BasePoses
    batch: Batch
    basis: Array
    reprojection: Reprojection
    bones: BoneLengths
    terms: tuple[Term, ...]
    is_free: NDArray[np.bool_]
    limits_accelerations: bool = False

    @property
    def coupled_frames(self) -> int:
        """Number of next frames with which a frame is coupled."""
        return 2 if self.limits_accelerations else 1

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
        reprojection = Reprojection.build(windows, units, config)
        bones = BoneLengths.build(batch, windows, model, config)
        terms: list[Term] = [
            reprojection,
            bones,
            BasePosePrior(prior / model.std**2),
            PoseSmoothness(smooth * batch.inverse_time_steps),
            CameraSmoothness.build(batch.inverse_time_steps, flip, tilt, config.scale_weight),
        ]
        if config.pose_acceleration_weight > 0:
            terms.append(PoseAcceleration.build(config.pose_acceleration_weight, TYPICAL_M_S2, batch))
            terms.append(CameraAcceleration.build(config.camera_acceleration_weight, TYPICAL_PER_S2, batch))
        if lifted is not None:
            terms.append(lifted)
        return JointObjective(
            model=model,
            batch=batch,
            basis=arrange_model(model).components,
            reprojection=reprojection,
            bones=bones,
            terms=tuple(terms),
            is_free=_find_free_frames(batch, [w.fixed_frames for w in windows]),
            limits_accelerations=config.pose_acceleration_weight > 0,
        )

    def find_term(self, kind: type[AnyTerm]) -> AnyTerm:
        """Return the term of a class; raises StopIteration where there is none."""
        return next(term for term in self.terms if isinstance(term, kind))

    def with_components(self, k: int) -> JointObjective:
        """Return the objective with the first `k` base poses."""
        model, bones = self.model.truncate(k), self.bones.with_components(k)
        terms = tuple(bones if term is self.bones else term.with_components(k) for term in self.terms)
        return replace(self, model=model, basis=arrange_model(model).components, bones=bones, terms=terms)

    def subsampled(self, kept: Subsample) -> JointObjective:
        """Return the objective of some frames only."""
        bones, reprojection = self.bones.subsampled(kept), self.reprojection.subsampled(kept)
        further = (term.subsampled(kept) for term in self.terms if term not in (self.bones, self.reprojection))
        return replace(
            self,
            batch=kept.batch,
            reprojection=reprojection,
            bones=bones,
            terms=(reprojection, bones, *further),
            is_free=self.is_free[kept.frames],
        )

    def with_activity(self, state: State, coarse: Batch) -> JointObjective:
        """Return the objective whose limits to accelerations give way to those of some frames.

        Args:
            state: the unknowns in these frames.
            coarse: layout of these frames; the same sequences.
        """
        if not self.limits_accelerations:
            return self
        of_pose = measure_activity(state.theta, coarse, self.batch)
        of_camera = measure_activity(measure_directions(state.rotation), coarse, self.batch)
        terms: list[Term] = []
        for term in self.terms:
            if isinstance(term, PoseAcceleration):
                terms.append(term.with_activity(of_pose))
            else:
                terms.append(term.with_activity(of_camera) if isinstance(term, CameraAcceleration) else term)
        return replace(self, terms=tuple(terms))

    def with_noise(self, noise: Array) -> JointObjective:
        """Return the objective under image noise of these standard deviations (P,) m, one a sequence."""
        ratio = self.batch.repeat_per_frame(noise / NOISE_REFERENCE)
        reprojection = self.reprojection.with_variance_ratio(ratio)
        terms: list[Term] = []
        for term in self.terms:
            if isinstance(term, Acceleration):
                terms.append(term.with_noise_ratio(ratio))
            else:
                terms.append(reprojection if term is self.reprojection else term)
        return JointObjective(
            self.model,
            self.batch,
            self.basis,
            reprojection,
            self.bones,
            tuple(terms),
            self.is_free,
            self.limits_accelerations,
        )

    def fit(self, state: State, *, settle_translation: bool = False) -> Fit:
        """Return what the terms measure in a state.

        Args:
            state: the unknowns.
            settle_translation: whether each translation is first moved to its optimum (one step of the robust
                fit).
        """
        theta, rotation = np.ascontiguousarray(state.theta), np.ascontiguousarray(state.rotation)
        poses, scaled_poses = _pose_bodies(theta, rotation, state.log_scale, self.basis, self.model.mean)
        translation, depth, error, squared_error = self.reprojection.measure(
            scaled_poses, state.translation, settle_translation=settle_translation
        )
        direction, length, excess, mean = self.bones.measure(poses)
        return Fit(
            State(theta, rotation, state.log_scale, translation),
            self.model,
            scaled_poses,
            depth,
            error,
            squared_error,
            direction,
            length,
            excess,
            mean,
        )

    def with_optimal_translation(self, state: State) -> Fit:
        """Return the fit of the state with each translation at its optimum (one step of the robust fit)."""
        return self.fit(state, settle_translation=True)

    def cost(self, fit: Fit) -> Array:
        """(P,) m^2, value of the objective of each sequence."""
        per_frame = self.terms[0].cost(fit)
        for term in self.terms[1:]:
            per_frame += term.cost(fit)
        return self.batch.sum_per_sequence(per_frame)

    def normal_equations(self, fit: Fit, is_active: NDArray[np.bool_] | None = None) -> NormalEquations:
        """Return the equations of a Gauss-Newton step.

        Args:
            fit: of the state at hand.
            is_active: (N,) whether the equations of a frame are needed; None for those of all free frames.
        """
        is_active = self.is_free if is_active is None else is_active
        equations = NormalEquations.begin(fit, self.basis, len(self.bones.weight), is_active, self.coupled_frames)
        for term in self.terms:
            term.add_to(equations, fit)
        equations.transfer_from_joints()
        return equations

    def step(self, equations: NormalEquations, damping: Array) -> DampedSolution | None:
        """Solve for a Levenberg-Marquardt step.

        Args:
            equations: of the state at hand.
            damping: (P,) relative increase of the diagonal.

        Returns:
            A solution whose `solution` (N, n) is the negative of the step; None where the matrix is not positive
            definite.
        """
        return solve_damped(
            equations.diagonal,
            equations.coupling,
            equations.gradient,
            equations.bones,
            self.bones.strength,
            damping,
            self.is_free,
            self.batch.starts,
            self.batch.counts,
        )

    def joint_std(self, fit: Fit, last_inverse: Array) -> Array:
        """(P, J) m, posterior standard deviation of each sequence's last joints about the body's origin.

        It is the root of the trace of each joint's covariance.

        Args:
            fit: of the state at hand.
            last_inverse: (P, n, n) as in the solution of a step.
        """
        last, state = self.batch.starts + self.batch.counts - 1, fit.state
        size = np.exp(state.log_scale[last])[:, None, None]
        poses = fit.scaled_poses[last] / size
        return NOISE_REFERENCE * _spread_of_joints(last_inverse, state.rotation[last], poses, self.basis)

    def initial_state(self, starts: Sequence[InitialValues], units: Array) -> State:
        """Return the state at these starts, with the translations at the centroids of the image points.

        Args:
            starts: weights and cameras of each sequence, scales in px/m.
            units: (P,) px/m, as for `build`.
        """
        theta = np.concatenate([s.theta for s in starts])
        rotation = np.concatenate([s.cameras.rotation for s in starts])
        scale = np.concatenate([s.cameras.scale for s in starts]) / self.batch.repeat_per_frame(units)
        return State(theta, rotation, np.log(scale), self.reprojection.centroids())


def _find_free_frames(batch: Batch, fixed_frames: Sequence[int]) -> NDArray[np.bool_]:
    """Return (N,) False for the first `fixed_frames` (P,) of each sequence."""
    is_free = np.ones(len(batch.times), np.bool_)
    for start, fixed in zip(batch.starts.tolist(), fixed_frames, strict=True):
        is_free[start : start + fixed] = False
    return is_free


@kernel(types.UniTuple(FLOATS_3D, 2)(FLOATS_2D, FLOATS_3D, FLOATS_1D, FLOATS_2D, FLOATS_2D))
def _pose_bodies(
    theta: Array, rotation: Array, log_scale: Array, basis: Array, mean: Array
) -> tuple[Array, Array]:
    """Return the poses P = Q_0 + sum_l theta_l Q_l in the body frame and s R P in the camera's, both (N, J, 3)."""
    frames, k = theta.shape
    joints = len(mean)
    poses, scaled_poses = np.empty((frames, joints, 3)), np.empty((frames, joints, 3))
    for t in range(frames):
        pose = poses[t]
        pose[:] = mean
        add_product(1.0, basis, theta[t].reshape((k, 1)), pose.reshape((3 * joints, 1)))
        scale = np.exp(log_scale[t])
        r = rotation[t]
        for j in range(joints):
            x, y, z = pose[j, 0], pose[j, 1], pose[j, 2]
            for i in range(3):
                scaled_poses[t, j, i] = scale * (r[i, 0] * x + r[i, 1] * y + r[i, 2] * z)
    return poses, scaled_poses


@kernel(FLOATS_2D(FLOATS_3D, FLOATS_3D, FLOATS_3D, FLOATS_2D))
def _spread_of_joints(inverse: Array, rotation: Array, poses: Array, basis: Array) -> Array:
    """Return the root of the trace of J_j (L L^T)^-1 J_j^T for each joint of P frames, (P, J).

    Args:
        inverse: (P, n, n) matrices L^-1.
        rotation: (P, 3, 3) body frame to camera frame.
        poses: (P, J, 3) m, unscaled joints along the camera's axes, which the log scale does not move.
        basis: (3 J, K) the base poses, a coordinate of a joint in each row.
    """
    rows, n = len(basis), inverse.shape[1]
    jacobian = np.empty((rows, n))
    out = np.zeros((len(poses), rows // 3))
    for p in range(len(poses)):
        write_joint_jacobian(rotation[p], poses[p], basis, jacobian)
        jacobian[:, n - 1] = 0.0
        whitened = np.zeros((rows, n))
        add_product_transposed(1.0, jacobian, inverse[p], whitened)
        for row in range(rows):
            for i in range(n):
                out[p, row // 3] += whitened[row, i] ** 2
        for j in range(rows // 3):
            out[p, j] = np.sqrt(out[p, j])
    return out
