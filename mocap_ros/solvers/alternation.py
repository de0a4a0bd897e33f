"""Algorithm 1 of TPAMI 2016, plainly: cameras and base-pose weights in turn, for a whole sequence.

This is the readable reference. It minimises, over all cameras M_t and weights theta_t,

    sum_tj w_tj |M_t P_tj + t_t - x_tj|^2 / s0^2        reprojection (eq. 9), in m^2 at the body
  + beta   sum_tb (length_tb - mean_b)^2                bone lengths (eq. 20), lengths of one body all along
  + lambda sum_tl (theta_tl / sigma_l)^2                Gaussian prior of the base poses (not in the paper)
  + gamma  sum_t  |M_t - M_(t-1)|^2 / dt                flip regulariser (eq. 12)

with s0 the median start scale. `norm='frobenius'` takes the norms as the paper prints them (eq. 13 and 21: not
squared, variances not sums); it is minimised by the same steps, each weighted by one over twice the norm at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.weak_perspective import CameraProblem, Cameras, centred_on_seen, refine
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import Reconstruction, Window, begin

Array = NDArray[np.float64]

NORM_FLOOR = 1e-6
NEGLIGIBLE = 1e-12


def reconstruct(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    """Reconstruct one person's sequence (Algorithm 1).

    Args:
        window: image points, weights, times, and where to begin.
        model: base poses, metric.
        config: weights of the terms; smoothness and robust loss are not part of this model.

    Returns:
        The reconstruction; its objective is noted after every half step.
    """
    model = model.truncated(config.components)
    start, s0 = begin(window, model, config.start_window)
    theta, cameras = start.theta, start.cameras
    problem = _Problem.build(model, window, s0, config)
    cameras = Cameras(cameras.scale / s0, cameras.rotation)

    progress = _Progress([problem.objective(cameras, theta)])
    while not progress.converged and progress.iterations < config.max_iterations:
        cameras = problem.cameras_step(cameras, theta)
        after_cameras = problem.objective(cameras, theta)
        theta = problem.weights_step(cameras, theta)
        progress.note(after_cameras, problem.objective(cameras, theta), config.tolerance)
    return _result(problem, cameras, theta, s0, progress)


@dataclass
class _Progress:
    objective: list[float]
    iterations: int = 0
    converged: bool = False

    def note(self, after_cameras: float, after_weights: float, tolerance: float) -> None:
        before = self.objective[-1]
        self.objective += [after_cameras, after_weights]
        self.iterations += 1
        self.converged = before - after_weights <= tolerance * before


@dataclass(frozen=True, eq=False)
class _Problem:
    model: BasePoses
    image: Array
    centroid: Array
    weight: Array
    flip: Array
    beta: float
    prior: Array
    frobenius: bool
    parents: NDArray[np.intp]
    children: NDArray[np.intp]
    bone_directions: Array

    @staticmethod
    def build(model: BasePoses, window: Window, s0: float, config: SolverConfig) -> _Problem:
        parents, children = (np.array(side) for side in zip(*model.skeleton.bones, strict=True))
        image, centroid = centred_on_seen(window.points / s0, window.weight)
        return _Problem(
            model=model,
            image=image,
            centroid=centroid,
            weight=window.weight,
            flip=config.flip_weight / np.maximum(np.diff(window.times), 1e-4),
            beta=config.bone_weight,
            prior=config.prior_weight / model.std**2,
            frobenius=config.norm == 'frobenius',
            parents=parents,
            children=children,
            bone_directions=model.components[:, children] - model.components[:, parents],
        )

    def cameras_problem(self, theta: Array) -> CameraProblem:
        body, _ = centred_on_seen(self.model.poses(theta), self.weight)
        return CameraProblem(body, self.image, self.weight, self.flip)

    def bones(self, theta: Array) -> tuple[Array, Array]:
        """(F, B) lengths in m and (F, B, 3) unit vectors of the bones."""
        poses = self.model.poses(theta)
        vector = poses[:, self.children] - poses[:, self.parents]
        length = np.maximum(np.linalg.norm(vector, axis=-1), 1e-9)
        return length, vector / length[..., None]

    def terms(self, cameras: Cameras, theta: Array) -> tuple[Array, Array, float, float]:
        """Squared reprojection a frame, squared camera change a pair, bone and prior term."""
        problem = self.cameras_problem(theta)
        length, _ = self.bones(theta)
        spread = float(((length - length.mean(axis=0)) ** 2).sum())
        prior = float((self.prior * theta**2).sum())
        return problem.data_cost(cameras), problem.flip_cost(cameras), self.beta * spread, prior

    def objective(self, cameras: Cameras, theta: Array) -> float:
        data, flip, bones, prior = self.terms(cameras, theta)
        if not self.frobenius:
            return float(data.sum() + flip.sum() + bones + prior)
        gamma = np.sqrt(self.flip)
        return float(_norm(data.sum()) + (gamma * _norm(flip)).sum() + bones / len(theta) + prior)

    def cameras_step(self, cameras: Cameras, theta: Array) -> Cameras:
        """Lower eq. 13 over the cameras with the poses held."""
        problem = self.cameras_problem(theta)
        if self.frobenius:
            norm = _norm(problem.data_cost(cameras).sum())
            change = _norm(problem.flip_cost(cameras))
            problem = CameraProblem(
                problem.body,
                problem.image,
                problem.weight / (2 * norm),
                self.flip * np.sqrt(self.flip) / (2 * change),
            )
        return refine(problem, cameras)

    def weights_step(self, cameras: Cameras, theta: Array) -> Array:
        """Lower eq. 21 over the weights with the cameras held: one damped Gauss-Newton step, or more.

        Every frame has its own K x K block; the mean bone lengths, shared by all frames, subtract a matrix of
        rank B (number of bones) from the block diagonal, which Woodbury's identity takes care of exactly.
        """
        frames, k = theta.shape
        data_weight, bone_weight = 1.0, self.beta
        if self.frobenius:
            data = self.cameras_problem(theta).data_cost(cameras)
            data_weight = float(1 / (2 * _norm(data.sum())))
            bone_weight = self.beta / frames
        root = np.sqrt(data_weight * self.weight)[..., None]
        basis = np.moveaxis(self.model.components, 0, -1).reshape(len(self.model.mean), -1)
        seen_basis, _ = centred_on_seen(np.broadcast_to(basis, (frames, *basis.shape)), self.weight)
        seen_basis = seen_basis.reshape(frames, -1, 3, k)
        jac = (cameras.matrix[:, None] @ seen_basis) * root[..., None]
        jac = jac.reshape(frames, -1, k)
        body, _ = centred_on_seen(self.model.poses(theta), self.weight)
        error = ((cameras.project(body) - self.image) * root).reshape(frames, -1, 1)

        length, unit = self.bones(theta)
        bone_jac = np.einsum('fbd,kbd->fbk', unit, self.bone_directions)
        bone_error = length - length.mean(axis=0)
        jac_t = np.swapaxes(jac, -1, -2)
        bone_t = np.swapaxes(bone_jac, -1, -2)
        blocks = jac_t @ jac + bone_weight * (bone_t @ bone_jac) + np.diag(self.prior)
        gradient = jac_t @ error + bone_weight * (bone_t @ bone_error[..., None])
        gradient = gradient[..., 0] + self.prior * theta

        before = self.objective(cameras, theta)
        damping = 1e-6
        for _ in range(8):
            step = _arrowhead_solve(blocks, bone_t, bone_weight / frames, gradient, damping)
            tried = theta - step
            if self.objective(cameras, tried) <= before:
                return tried
            damping = max(damping * 30, 1e-3)
        return theta


def _norm(squared: Array) -> Array:
    """The norm from its square, rounded off at zero where the norm has no gradient."""
    return np.asarray(np.sqrt(squared + NORM_FLOOR**2))


def _arrowhead_solve(blocks: Array, coupling: Array, strength: float, gradient: Array, damping: float) -> Array:
    """Solve (blockdiag(blocks) - strength * sum_b g_b g_b^T) x = gradient.

    Args:
        blocks: (F, K, K) positive definite.
        coupling: (F, K, B), the vectors g_b cut into frames.
        strength: beta / F.
        gradient: (F, K).
        damping: relative increase of the diagonal (Levenberg-Marquardt).
    """
    damped = blocks + damping * np.einsum('fii->fi', blocks)[..., None] * np.eye(blocks.shape[-1])
    solved = np.linalg.solve(damped, np.concatenate([gradient[..., None], coupling], axis=-1))
    x, y = solved[..., 0], solved[..., 1:]
    if strength < NEGLIGIBLE:
        return np.asarray(x)
    inner = np.eye(coupling.shape[-1]) / strength - np.einsum('fkb,fkc->bc', coupling, y)
    correction = np.linalg.solve(inner, np.einsum('fkb,fk->b', coupling, x))
    return np.asarray(x + y @ correction)


def _result(
    problem: _Problem,
    cameras: Cameras,
    theta: Array,
    s0: float,
    progress: _Progress,
) -> Reconstruction:
    poses = problem.model.poses(theta)
    body, body_centroid = centred_on_seen(poses, problem.weight)
    cameras_px = Cameras(cameras.scale * s0, cameras.rotation)
    offset = (cameras_px.matrix @ body_centroid[..., None])[..., 0]
    error = cameras_px.project(body) - problem.image * s0
    seen = problem.weight > 0
    with np.errstate(invalid='ignore'):
        residual = np.sqrt((seen[..., None] * error**2).sum(axis=(1, 2)) / seen.sum(axis=1))
    return Reconstruction(
        joints=poses @ np.swapaxes(cameras.rotation, -1, -2),
        theta=theta,
        cameras=cameras_px,
        translation=problem.centroid * s0 - offset,
        residual=residual,
        objective=tuple(progress.objective),
        iterations=progress.iterations,
        converged=progress.converged,
        noise=float('nan'),
        spread=np.full(poses.shape[1], np.nan),
    )
