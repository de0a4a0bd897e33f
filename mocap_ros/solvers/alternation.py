# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Algorithm 1 of TPAMI 2016: optimise cameras and base-pose weights in turn, for a whole sequence.

The readable reference with which the tests compare the joint solver. With P_tj = Q_0j + sum_l theta_tl Q_lj (eq.
1), M_t = s_t R_t[:2], s0 the median initial scale, and translations t_t eliminated by weighted centroids, it
minimises

    sum_tj w_tj |M_t P_tj + t_t - x_tj|^2 / s0^2        reprojection error (eq. 9), m^2 at the body
  + beta   sum_tb (length_tb - mean_b)^2                bone lengths are constant over time (eq. 19 and 20)
  + lambda sum_tl (theta_tl / sigma_l)^2                Gaussian prior of the base poses (not in the paper)
  + gamma  sum_t  |M_t - M_(t-1)|_F^2 / (s0^2 dt_t)     flip regulariser (eq. 12)

    Algorithm 1: recover camera and shape
    Q <- base shapes                                              `PoseModel.truncate`
    while no convergence do                                       `reconstruct`
        for t = 1 -> f do                                         all frames at once
            calculate starting values for M_t    (eq. 10, 11)     `choose_initial_values`, only before the loop
            optimise |w_t - M_t Theta_t Q|_F + r_K,t    (eq. 13)  `AlternationProblem.optimise_cameras`
        end for
        optimise |W - M Theta Q|_F + r_B                (eq. 21)  `AlternationProblem.optimise_weights`
    end while
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.geometry.weak_perspective import (
    CameraStepObjective,
    WeakPerspectiveCameras,
    run_camera_step,
    subtract_weighted_centroid,
)
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers.window import (
    Reconstruction,
    SolverStatus,
    Window,
    choose_initial_values,
    interpolate_unseen,
)

MIN_TIME_STEP_S = 1e-4  # s; guards the division by dt; far below the period of any camera
MIN_BONE_LENGTH_M = 1e-9  # m; guards the division by the length of a bone
MIN_COUPLING = 1e-12  # beta / F below which the frames are independent; guards the division by it
INITIAL_DAMPING = 1e-6  # relative; almost a full Gauss-Newton step, which is tried first
DAMPING_GROWTH = 30.0  # factor on the damping after a step that raised the objective
MIN_RAISED_DAMPING = 1e-3  # relative; smallest damping after a rejected step, since 3e-5 would hardly change it
MAX_DAMPING_TRIALS = 8  # steps tried in an iteration; the last has a damping of 7e5, that is a step of almost zero


def reconstruct(window: Window, model: PoseModel, config: SolverConfig) -> Reconstruction:
    """Reconstruct the sequence of one person (TPAMI 2016, Algorithm 1), without smoothness and robust loss."""
    model = model.truncate(config.components)  # Q <- base shapes
    start, s0 = choose_initial_values(window, model, config.start_window)  # theta = 0; M_t from eq. 10 and 11
    problem = AlternationProblem.build(model, window, s0, config)
    theta = start.theta
    cameras = WeakPerspectiveCameras(start.cameras.scale / s0, start.cameras.rotation)
    history, status = [problem.objective(cameras, theta)], SolverStatus.MAX_ITERATIONS
    while status is SolverStatus.MAX_ITERATIONS and len(history) <= 2 * config.max_iterations:
        before = history[-1]
        cameras = problem.optimise_cameras(cameras, theta)  # all M_t by eq. 13, which is eq. 9 + eq. 12
        history.append(problem.objective(cameras, theta))
        theta = problem.optimise_weights(cameras, theta)  # Theta by eq. 21, which is eq. 9 of all frames + eq. 20
        history.append(problem.objective(cameras, theta))
        if before - history[-1] <= config.tolerance * before:
            status = SolverStatus.CONVERGED if history[-1] < before else SolverStatus.NO_LOWER_STEP
    result = _make_reconstruction(problem, cameras, theta, s0, status, history)
    return replace(result, translation=interpolate_unseen(result.translation, window))


@dataclass(frozen=True, eq=False)
class AlternationProblem:
    """The objective of one sequence, and the steps that lower it."""

    model: PoseModel
    image: Array  # (F, J, 2) m, image points divided by s0, relative to their weighted centroid
    centroid: Array  # (F, 2) m, this centroid
    weight: Array  # (F, J) confidence scores
    flip: Array  # (F - 1,) gamma / dt
    beta: float
    prior: Array  # (K,) lambda / sigma_l^2
    parents: NDArray[np.intp]  # (B,) index of each bone's inner joint
    children: NDArray[np.intp]  # (B,) index of each bone's outer joint
    bone_components: Array  # (K, B, 3) change of each bone's vector by each base pose

    @staticmethod
    def build(model: PoseModel, window: Window, s0: float, config: SolverConfig) -> AlternationProblem:
        """Return the problem of a window; `s0` in px/m."""
        parents, children = (np.array(side) for side in zip(*model.skeleton.bones, strict=True))
        image, centroid = subtract_weighted_centroid(window.points / s0, window.weight)
        return AlternationProblem(
            model=model,
            image=image,
            centroid=centroid,
            weight=window.weight,
            flip=config.flip_weight / np.maximum(np.diff(window.times), MIN_TIME_STEP_S),
            beta=config.bone_weight,
            prior=config.prior_weight / model.std**2,
            parents=parents,
            children=children,
            bone_components=model.components[:, children] - model.components[:, parents],
        )

    def camera_objective(self, theta: Array) -> CameraStepObjective:
        """Return the squared form of eq. 13 for the poses of `theta` (F, K)."""
        body, _ = subtract_weighted_centroid(self.model.poses(theta), self.weight)
        return CameraStepObjective(body, self.image, self.weight, self.flip)

    def bone_lengths(self, theta: Array) -> tuple[Array, Array]:
        """Return the lengths (F, B) in m (eq. 19) and the unit vectors (F, B, 3) of the bones."""
        poses = self.model.poses(theta)
        vector = poses[:, self.children] - poses[:, self.parents]
        length = np.maximum(np.linalg.norm(vector, axis=-1), MIN_BONE_LENGTH_M)
        return length, vector / length[..., None]

    def objective(self, cameras: WeakPerspectiveCameras, theta: Array) -> float:
        """Return the value of the objective at the head of this module."""
        camera_objective = self.camera_objective(theta)
        length, _ = self.bone_lengths(theta)
        deviation = float(((length - length.mean(axis=0)) ** 2).sum())
        prior = float((self.prior * theta**2).sum())
        data, flip = camera_objective.data_cost(cameras), camera_objective.flip_cost(cameras)
        return float(data.sum() + flip.sum() + self.beta * deviation + prior)

    def optimise_cameras(self, cameras: WeakPerspectiveCameras, theta: Array) -> WeakPerspectiveCameras:
        """Return cameras that lower eq. 13 (eq. 9 + eq. 12), the poses fixed."""
        return run_camera_step(self.camera_objective(theta), cameras)

    def optimise_weights(self, cameras: WeakPerspectiveCameras, theta: Array) -> Array:
        """Return weights (F, K) after a Gauss-Newton step, damped until it does not raise eq. 21."""
        equations = self.weight_equations(cameras, theta)
        before = self.objective(cameras, theta)
        damping = INITIAL_DAMPING
        for _ in range(MAX_DAMPING_TRIALS):
            candidate = theta - solve_coupled_blocks(*equations, damping)
            if self.objective(cameras, candidate) <= before:
                return candidate
            damping = max(damping * DAMPING_GROWTH, MIN_RAISED_DAMPING)
        return theta

    def weight_equations(self, cameras: WeakPerspectiveCameras, theta: Array) -> tuple[Array, Array, float, Array]:
        """Return the Gauss-Newton equations of eq. 21, for `solve_coupled_blocks`.

            block_t    = A_t^T A_t + beta B_t^T B_t + diag(lambda / sigma^2)
            gradient_t = A_t^T e_t + beta B_t^T (b_t - mean b) + lambda theta_t / sigma^2

        with the Jacobians A_t and B_t of reprojection errors e_t and bone lengths b_t. The means subtract (beta /
        F) G G^T.
        """
        frames, k = theta.shape
        root = np.sqrt(self.weight)[..., None]
        basis = np.moveaxis(self.model.components, 0, -1).reshape(len(self.model.mean), -1)
        centred_basis, _ = subtract_weighted_centroid(np.broadcast_to(basis, (frames, *basis.shape)), self.weight)
        centred_basis = centred_basis.reshape(frames, -1, 3, k)
        jac = (cameras.matrix[:, None] @ centred_basis) * root[..., None]
        jac = jac.reshape(frames, -1, k)
        body, _ = subtract_weighted_centroid(self.model.poses(theta), self.weight)
        error = ((cameras.project(body) - self.image) * root).reshape(frames, -1, 1)

        length, unit = self.bone_lengths(theta)
        bone_jac = np.einsum('fbd,kbd->fbk', unit, self.bone_components)
        bone_error = length - length.mean(axis=0)
        jac_t = np.swapaxes(jac, -1, -2)
        bone_t = np.swapaxes(bone_jac, -1, -2)
        blocks = jac_t @ jac + self.beta * (bone_t @ bone_jac) + np.diag(self.prior)
        gradient = jac_t @ error + self.beta * (bone_t @ bone_error[..., None])
        gradient = gradient[..., 0] + self.prior * theta
        return blocks, bone_t, self.beta / frames, gradient


def solve_coupled_blocks(
    blocks: Array, coupling: Array, coupling_weight: float, right: Array, damping: float
) -> Array:
    """Solve (D - c G G^T) x = r, D block diagonal: x = D^-1 r + D^-1 G (I / c - G^T D^-1 G)^-1 G^T D^-1 r.

    Woodbury's identity. Blocks (F, K, K) are positive semidefinite, coupling G (F, K, B), r (F, K). Below
    `MIN_COUPLING` c counts as 0. Zeros on the diagonal become `damping`, so that unknowns of which nothing is
    known stay.
    """
    diagonal = np.einsum('fii->fi', blocks)
    damped = blocks + damping * np.where(diagonal > 0, diagonal, 1.0)[..., None] * np.eye(blocks.shape[-1])
    solved = np.linalg.solve(damped, np.concatenate([right[..., None], coupling], axis=-1))
    uncoupled, solved_coupling = solved[..., 0], solved[..., 1:]
    if coupling_weight < MIN_COUPLING:
        return np.asarray(uncoupled)
    inner = np.eye(coupling.shape[-1]) / coupling_weight - np.einsum('fkb,fkc->bc', coupling, solved_coupling)
    correction = np.linalg.solve(inner, np.einsum('fkb,fk->b', coupling, uncoupled))
    return np.asarray(uncoupled + solved_coupling @ correction)


def _make_reconstruction(
    problem: AlternationProblem,
    cameras: WeakPerspectiveCameras,
    theta: Array,
    s0: float,
    status: SolverStatus,
    history: Sequence[float],
) -> Reconstruction:
    """Return the result in px and px/m; the scales of `cameras` are relative to `s0` (px/m)."""
    poses = problem.model.poses(theta)
    body, body_centroid = subtract_weighted_centroid(poses, problem.weight)
    cameras_px = WeakPerspectiveCameras(cameras.scale * s0, cameras.rotation)
    offset = (cameras_px.matrix @ body_centroid[..., None])[..., 0]
    error = cameras_px.project(body) - problem.image * s0
    seen = problem.weight > 0
    with np.errstate(invalid='ignore'):  # a frame without seen joints has the residual 0 / 0 = NaN
        residual = np.sqrt((seen[..., None] * error**2).sum(axis=(1, 2)) / seen.sum(axis=1))
    return Reconstruction(
        joints=poses @ np.swapaxes(cameras.rotation, -1, -2),
        theta=theta,
        cameras=cameras_px,
        translation=problem.centroid * s0 - offset,
        residual=residual,
        status=status,
        history=tuple(history),
        iterations=len(history) // 2,
    )
