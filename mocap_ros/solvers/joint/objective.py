"""The objective of the joint solver, its derivatives, and the linear system of a step.

That of `alternation` with some terms more,

    sum_tj w_tj rho(|s_t R_t[:2] P_tj + t_t - x_tj|^2 / s0^2)   reprojection; rho = Cauchy's loss, or none
  + beta   sum_tb (length_tb - mean_b)^2                        bone lengths (TPAMI 2016, eq. 20)
  + lambda sum_tl (theta_tl / sigma_l)^2                        Gaussian prior of the base poses
  + mu     sum_tl ((theta_tl - theta_(t-1)l) / sigma_l)^2 / dt  smoothness
  + gamma  sum_t  |M_t - M_(t-1)|^2 / dt                        flip regulariser (eq. 12)
  + tau    sum_t  |R_t z - R_(t-1) z|^2 / dt                    tilt: the image of the vertical turns slowly
  + sigma  sum_t  (log s_t - log s_(t-1))^2 / dt                people come nearer slowly
  + omega  sum_tj rho(|s_t R_t P_tj - lifted_tj|^2 / spread^2)  learned prior (`learned_prior`), where there is one

over all frames at once. Where the focal length f is known the projection is a perspective one,
(s_t R_t[:2] P_tj + t_t) / (1 + s_t R_t[2] P_tj / f). All weights but the first are for an image noise of 10 mm;
with `adapt_noise` they grow and shrink with its variance, which is found from the residual in a few rounds, as the
maximum of the posterior demands. A frame has K weights, three rotation parameters and a log scale; its translation
is eliminated. The normal matrix is block tridiagonal, the mean bone lengths are eliminated exactly by a low-rank
correction, and any number of people and hypotheses are solved as one batch: their sequences stand one after the
other in the same arrays with no coupling across the seams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import cross_matrix
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.block_banded import Coupling, Factor, factor, solve_less_low_rank
from mocap_ros.solvers.joint.lifted_pose import LiftedTerm
from mocap_ros.solvers.joint.state import Fit, NormalEquations, State
from mocap_ros.solvers.window import Start, Window

Array = NDArray[np.float64]

CAMERA_UNKNOWNS = 4
SHORTEST_STEP = 1e-4
HOLD = 1e9
NEAREST = 0.1

NOISE_REFERENCE = 0.01
LEAST_FREE = 0.05
LEAST_ROBUST = 1e-6
FRAMES_FOR_NOISE, LESS_OFTEN = 3, 15


@dataclass(frozen=True, eq=False)
class Problem:
    """A batch of sequences, concatenated; image points in metres at the body (px / s0).

    Attributes:
        image: (N, J, 2).
        weight: (N, J) detector scores over `level`.
        level: (N,) variance of the noise over that of the reference.
        times: (N,) s.
        starts: (P,) first frame of each sequence.
        counts: (P,) frames of each.
        smooth: (N - 1,) weight of (change of theta / sigma)^2 to the next frame, 0 across a seam.
        turn: (N - 1, 9) weights of (change of `Fit.turning`)^2, 0 across a seam: flip, tilt, approach.
        bone_weight: (B,).
        robust: (N, 1) m, scale of Cauchy's loss; infinite for least squares.
        focal: (N, 1) m at the body; infinite for weak perspective.
        held: (N,) True for frames that keep their start.
        older_bones: (P, B) m, mean bone lengths of `older` (P,) frames before each sequence.
        lifted: the learned prior's term, or None.
    """

    model: BasePoses
    image: Array
    weight: Array
    level: Array
    times: Array
    starts: NDArray[np.intp]
    counts: NDArray[np.intp]
    smooth: Array
    turn: Array
    prior: Array
    bone_weight: Array
    robust: Array
    focal: Array
    held: NDArray[np.bool_]
    older_bones: Array
    older: NDArray[np.intp]
    lifted: LiftedTerm | None
    parents: NDArray[np.intp]
    children: NDArray[np.intp]

    @staticmethod
    def build(windows: Sequence[Window], s0: Array, model: BasePoses, config: SolverConfig) -> Problem:
        """The batch of these windows, each divided by its own `s0` (P,) px/m."""
        counts = np.array([len(w.times) for w in windows])
        starts = np.cumsum(counts) - counts
        times = np.concatenate([w.times for w in windows])
        inverse_dt = 1 / np.maximum(np.diff(times), SHORTEST_STEP)
        inverse_dt[starts[1:] - 1] = 0.0
        parents, children = (np.array(side) for side in zip(*model.skeleton.bones, strict=True))
        lengths = model.skeleton.bone_lengths(model.mean)
        relative = (lengths.mean() / lengths) ** 2 if config.relative_bones else np.ones(len(lengths))
        flip, tilt, prior = config.flip_weight, 0.0, config.prior_weight
        if model.upright:
            flip, tilt, prior = (
                config.heading_flip_factor * flip,
                config.tilt_weight,
                config.heading_prior_factor * prior,
            )
        lifted, smooth = LiftedTerm.of(windows, s0, config), config.smooth_weight
        if lifted is not None:
            prior, smooth = config.lifter_prior_factor * prior, config.lifter_smooth_factor * smooth
            flip = config.lifter_flip_factor * flip
        return Problem(
            model=model,
            image=np.concatenate([w.points / s for w, s in zip(windows, s0, strict=True)]),
            weight=np.concatenate([w.weight for w in windows]),
            level=np.ones(len(times)),
            times=times,
            starts=starts,
            counts=counts,
            smooth=smooth * inverse_dt,
            turn=inverse_dt[:, None] * ([*[flip] * 3, tilt] * 2 + [config.scale_weight]),
            prior=prior / model.std**2,
            bone_weight=config.bone_weight * relative,
            robust=np.full((len(times), 1), config.robust_scale if config.robust_scale > LEAST_ROBUST else np.inf),
            focal=np.repeat([w.focal / s for w, s in zip(windows, s0, strict=True)], counts)[:, None],
            held=np.concatenate([np.arange(len(w.times)) < w.held for w in windows]),
            older_bones=np.array([lengths if w.older is None else w.older.bone_lengths for w in windows]),
            older=np.array([0 if w.older is None else w.older.frames for w in windows]),
            lifted=lifted,
            parents=parents,
            children=children,
        )

    def truncated(self, k: int) -> Problem:
        """The same batch with the first `k` base poses."""
        return replace(self, model=self.model.truncated(k), prior=self.prior[:k])

    def thinned(self, step: float) -> tuple[Problem, NDArray[np.intp]]:
        """The best seen frame of each `step` s, coupled as much for its data as all frames are; and its index."""
        sequence = np.repeat(np.arange(len(self.starts)), self.counts)
        part = np.floor((self.times - self.times[self.starts][sequence]) / step + 1e-6)
        order = np.lexsort((-self.weight.sum(axis=1), part, sequence))
        new = np.diff(part[order], prepend=-1) != 0
        new[self.starts] = True
        kept = np.sort(order[new])
        counts = np.bincount(sequence[kept], minlength=len(self.starts))
        before, after = kept[:-1], kept[1:]
        old, now = (np.maximum(self.times[to] - self.times[before], SHORTEST_STEP) for to in (before + 1, after))
        share = (counts / self.counts)[sequence[before]]
        ratio = np.where(sequence[before] == sequence[after], share * old / now, 0.0)
        few = replace(
            self,
            image=self.image[kept],
            weight=self.weight[kept],
            level=self.level[kept],
            times=self.times[kept],
            starts=np.cumsum(counts) - counts,
            counts=counts,
            smooth=self.smooth[before] * ratio,
            turn=self.turn[before] * ratio[:, None],
            robust=self.robust[kept],
            focal=self.focal[kept],
            held=self.held[kept],
            lifted=None if self.lifted is None else self.lifted.take(kept),
        )
        return few, kept

    def under_noise(self, noise: Array) -> Problem:
        """The same batch with these standard deviations (P,) m of the noise."""
        ratio = self.per_frame(noise / NOISE_REFERENCE)
        old = np.sqrt(self.level)
        return replace(
            self,
            weight=self.weight * (self.level / ratio**2)[:, None],
            level=ratio**2,
            robust=self.robust * (np.maximum(ratio, 1) / np.maximum(old, 1))[:, None],
        )

    def noise(self, fit: Fit, equations: NormalEquations) -> Array:
        """(P,) m, standard deviation of a coordinate of a fully trusted point, from the residual.

        The sum of squares is shared among the coordinates less those that the unknowns have absorbed, their
        neighbours held; `equations` may be those of a state nearby.
        """
        loss = self.level[:, None] * self.weight * self._loss(fit.squared)
        coordinates = 2 * self.per_sequence((self.weight > 0).sum(axis=1))
        free = np.maximum(coordinates - self._absorbed(equations), LEAST_FREE * coordinates + 1)
        return np.sqrt(self.per_sequence(loss.sum(axis=1)) / free)

    def _absorbed(self, equations: NormalEquations) -> Array:
        """(P,) coordinates that the unknowns fit away, from some frames of each sequence."""
        stride = -(-self.counts // (FRAMES_FOR_NOISE + self.counts // LESS_OFTEN))
        number = np.arange(len(self.level)) - self.per_frame(self.starts)
        some = np.flatnonzero(number % self.per_frame(stride) == 0)
        taken = -(-self.counts // stride)
        whole = equations.diagonal[some] + 1e-9 * np.eye(equations.diagonal.shape[1])
        data = np.swapaxes(equations.data[some], -1, -2)
        absorbed = 2 + (data * np.linalg.solve(whole, data)).sum(axis=(1, 2))
        return np.add.reduceat(absorbed, np.cumsum(taken) - taken) * (self.counts / taken)

    def per_sequence(self, per_frame: Array) -> Array:
        """(N, ...) -> (P, ...) sums over the frames of each sequence."""
        return np.asarray(np.add.reduceat(per_frame, self.starts, axis=0))

    def per_frame(self, per_sequence: NDArray[Any]) -> NDArray[Any]:
        """(P, ...) -> (N, ...), each sequence's value for all its frames."""
        return np.asarray(np.repeat(per_sequence, self.counts, axis=0))

    def fit(self, state: State) -> Fit:
        """How a state fits."""
        poses = self.model.poses(state.theta)
        scale = np.exp(state.log_scale)[:, None, None]
        columns = np.swapaxes(state.rotation, -1, -2)
        turned = scale * (poses @ columns)
        depth = np.maximum(1 + turned[..., 2] / self.focal, NEAREST)
        error = (turned[..., :2] + state.translation[:, None]) / depth[..., None] - self.image
        vector = poses[:, self.children] - poses[:, self.parents]
        length = np.maximum(np.sqrt(np.einsum('nbd,nbd->nb', vector, vector)), 1e-9)
        total = self.per_sequence(length) + self.older[:, None] * self.older_bones
        means = total / (self.counts + self.older)[:, None]
        turning = np.empty((len(poses), 9))
        turning[:, [0, 1, 2]], turning[:, [4, 5, 6]] = np.moveaxis(scale * state.rotation[:, :2], 1, 0)
        turning[:, [3, 7]], turning[:, 8] = state.rotation[:, :2, 2], state.log_scale
        return Fit(
            state=state,
            turned=turned,
            depth=depth,
            error=error,
            squared=np.einsum('njd,njd->nj', error, error),
            bones=vector / length[..., None],
            length=length,
            excess=length - self.per_frame(means),
            means=means,
            turning=turning,
        )

    def settled(self, state: State) -> Fit:
        """The fit with each frame's translation at its weighted optimum (a step of the robust fit)."""
        fit = self.fit(state)
        w = self._robust_weight(fit.squared) / fit.depth
        total = np.maximum((w / fit.depth).sum(axis=1), 1e-12)[:, None]
        shift = -np.einsum('nj,njd->nd', w, fit.error) / total
        error = fit.error + shift[:, None] / fit.depth[..., None]
        return replace(
            fit,
            state=replace(state, translation=state.translation + shift),
            error=error,
            squared=np.einsum('njd,njd->nj', error, error),
        )

    def _loss(self, squared: Array) -> Array:
        if np.isinf(self.robust[0, 0]):
            return squared
        return np.asarray(self.robust**2 * np.log1p(squared / self.robust**2))

    def _robust_weight(self, squared: Array) -> Array:
        return np.asarray(self.weight / (1 + squared / self.robust**2))

    def cost(self, fit: Fit) -> Array:
        """(P,) value of the objective, m^2."""
        theta = fit.state.theta
        frame = np.einsum('nj,nj->n', self.weight, self._loss(fit.squared))
        if self.lifted is not None:
            frame += self.lifted.cost(fit.turned)
        frame += fit.excess**2 @ self.bone_weight + theta**2 @ self.prior
        frame[:-1] += self.smooth * ((theta[1:] - theta[:-1]) ** 2 @ self.model.std**-2)
        frame[:-1] += np.einsum('nc,nc->n', self.turn, (fit.turning[1:] - fit.turning[:-1]) ** 2)
        of_older = (fit.means - self.older_bones) ** 2 @ self.bone_weight
        return np.asarray(self.per_sequence(frame) + self.older * of_older)

    def normal_equations(self, fit: Fit) -> NormalEquations:
        """Everything of the second order that the step needs."""
        frames, k = fit.state.theta.shape
        n = k + CAMERA_UNKNOWNS
        basis = np.moveaxis(self.model.components, 0, -1)  # (J, 3, K)
        residual, data = self._data_rows(fit, basis)

        direction = basis[self.children] - basis[self.parents]  # (B, 3, K)
        bone_jac = np.swapaxes(np.swapaxes(fit.bones, 0, 1) @ direction, 0, 1)  # (N, B, K)
        bones = np.zeros((frames, n, len(direction)))
        bones[:, :k] = np.swapaxes(bone_jac * np.sqrt(self.bone_weight)[:, None], -1, -2)

        # Gauss-Newton leaves out the second derivatives of bones and then needs several times the steps; those of
        # bones too long are put in, those of bones too short would be negative
        curved = self.bone_weight * np.maximum(fit.excess / fit.length, 0)
        along = np.zeros((frames, len(direction), n))
        along[..., :k] = bone_jac * np.sqrt(self.bone_weight - curved)[..., None]
        rows, residuals = [data, along], [residual, np.zeros_like(curved)]
        if self.lifted is not None:
            scaled = np.exp(fit.state.log_scale)[:, None, None] * fit.state.rotation
            for part, new in zip((residuals, rows), self.lifted.rows(fit.turned, scaled, basis), strict=True):
                part.append(new)
        jac = np.concatenate(rows, axis=1)
        transposed = np.swapaxes(jac, -1, -2)
        diagonal = transposed @ jac
        squares = (np.swapaxes(direction, -1, -2) @ direction).reshape(len(direction), -1)
        diagonal[:, :k, :k] += (curved @ squares).reshape(frames, k, k)
        gradient = (transposed @ np.concatenate(residuals, axis=1)[..., None])[..., 0]
        gradient += (bones @ (np.sqrt(self.bone_weight) * fit.excess)[..., None])[..., 0]
        across = self._add_prior_and_smoothness(fit.state, diagonal, gradient)
        corner = self._add_camera_terms(fit, diagonal, gradient)
        return NormalEquations(data, diagonal, Coupling(across, corner), gradient, bones)

    def _data_rows(self, fit: Fit, basis: Array) -> tuple[Array, Array]:
        """(N, 2 J) reprojection errors and (N, 2 J, n) their derivatives, weighted, translations eliminated."""
        frames, joints = fit.squared.shape
        jac = self._projection_jacobian(fit, basis)  # (N, 2, J, n), times each joint's depth
        residual = np.swapaxes(fit.depth[..., None] * fit.error, 1, 2)  # (N, 2, J)

        # the best translation makes everything relative to its weighted mean
        w = self._robust_weight(fit.squared) / fit.depth**2
        share = (w / np.maximum(w.sum(axis=1), 1e-12)[:, None])[:, None]
        root = np.sqrt(w)[:, None]
        jac -= share[:, :, None] @ jac
        jac *= root[..., None]
        residual = root * (residual - (share * residual).sum(axis=2, keepdims=True))
        return residual.reshape(frames, -1), jac.reshape(frames, 2 * joints, -1)

    def _projection_jacobian(self, fit: Fit, basis: Array) -> Array:
        """(N, 2, J, n) derivatives of the image points, times each joint's depth; basis (J, 3, K)."""
        state, turned = fit.state, fit.turned
        frames, k = state.theta.shape
        joints = len(basis)
        perspective = bool(np.isfinite(self.focal).any())
        rows = 3 if perspective else 2
        m = np.exp(state.log_scale)[:, None, None] * state.rotation[:, :rows]
        flat = np.swapaxes(basis, 0, 1).reshape(3, -1)
        jac = np.empty((frames, rows, joints, k + CAMERA_UNKNOWNS))
        jac[..., :k] = (m.reshape(-1, 3) @ flat).reshape(frames, rows, joints, k)
        _fill_camera_columns(jac[..., k:], turned)
        if not perspective:
            return jac
        jac[:, 2, :, k:] = 0.0
        jac[:, 2, :, k], jac[:, 2, :, k + 1], jac[:, 2, :, k + 3] = turned[..., 1], -turned[..., 0], turned[..., 2]
        inward = np.swapaxes((fit.error + self.image) / self.focal[..., None], 1, 2)[..., None]
        return np.asarray(jac[:, :2] - inward * jac[:, 2:])

    def _add_prior_and_smoothness(self, state: State, diagonal: Array, gradient: Array) -> Array:
        """Add both terms; returns (N - 1, n), the diagonals of their coupling."""
        k = state.theta.shape[1]
        inverse_variance = 1 / self.model.std**2
        stiffness = np.zeros(len(state.theta))
        stiffness[:-1] += self.smooth
        stiffness[1:] += self.smooth
        on_diagonal = np.einsum('nii->ni', diagonal)
        on_diagonal[:, :k] += self.prior + stiffness[:, None] * inverse_variance
        across = np.zeros((len(self.smooth), diagonal.shape[1]))
        across[:, :k] = -self.smooth[:, None] * inverse_variance
        pull = self.smooth[:, None] * (state.theta[1:] - state.theta[:-1]) * inverse_variance
        gradient[:, :k] += self.prior * state.theta
        gradient[1:, :k] += pull
        gradient[:-1, :k] -= pull
        return across

    def _add_camera_terms(self, fit: Fit, diagonal: Array, gradient: Array) -> Array:
        """Add flip regulariser, tilt and approach, weighted changes; returns (N - 1, 4, 4), their coupling."""
        frames, k = fit.state.theta.shape
        columns = np.swapaxes(fit.state.rotation, -1, -2)
        points = np.empty((frames, 4, 3))
        points[:, :3] = np.exp(fit.state.log_scale)[:, None, None] * columns
        points[:, 3] = columns[:, 2]
        jac = np.zeros((frames, 9, CAMERA_UNKNOWNS))
        _fill_camera_columns(jac[:, :8].reshape(frames, 2, 4, CAMERA_UNKNOWNS), points)
        jac[:, [3, 7], 3] = 0.0
        jac[:, 8, 3] = 1.0
        weight = self.turn[..., None]
        transposed = np.swapaxes(jac, -1, -2)
        stiffness = np.zeros((frames, 9, 1))
        stiffness[:-1] += weight
        stiffness[1:] += weight
        diagonal[:, k:, k:] += transposed @ (stiffness * jac)
        corner = -transposed[1:] @ (weight * jac[:-1])
        pull = weight * (fit.turning[1:] - fit.turning[:-1])[..., None]
        gradient[1:, k:] += (transposed[1:] @ pull)[..., 0]
        gradient[:-1, k:] -= (transposed[:-1] @ pull)[..., 0]
        return np.asarray(corner)

    def step(self, equations: NormalEquations, damping: Array) -> tuple[Array, Factor] | None:
        """Levenberg-Marquardt with (P,) relative damping.

        Returns:
            (N, n) step, and the factored matrix without the bones' correction; None where it cannot be had.
        """
        diagonal = equations.diagonal.copy()
        on_diagonal = np.einsum('nii->ni', diagonal)
        on_diagonal *= 1 + self.per_frame(damping)[:, None]
        on_diagonal += 1e-12
        on_diagonal[self.held] += HOLD
        banded = factor(diagonal, equations.coupling)
        if banded is None:
            return None
        strength = 1 / (self.counts + self.older)
        return -solve_less_low_rank(banded, equations.gradient, equations.bones, strength, self.starts), banded

    def spread(self, fit: Fit, banded: Factor) -> Array:
        """(P, J) m, posterior standard deviation of each sequence's last joints about the body's origin.

        A Cholesky factor's last block is that of the marginal distribution of the last unknowns.
        """
        last = self.starts + self.counts - 1
        k = fit.state.theta.shape[1]
        inverse = np.linalg.inv(banded.diagonal_block(last, k + CAMERA_UNKNOWNS))
        rotation = fit.state.rotation[last]
        basis = np.swapaxes(self.model.components, 0, 1)  # (J, K, 3)
        by_theta = np.swapaxes(basis @ np.swapaxes(rotation, -1, -2)[:, None], -1, -2)
        turned = fit.turned[last] / np.exp(fit.state.log_scale[last])[:, None, None]
        by_camera = np.concatenate([-cross_matrix(turned), np.zeros((*turned.shape, 1))], axis=-1)
        jac = np.concatenate([by_theta, by_camera], axis=-1)  # (P, J, 3, n)
        sides = jac @ np.swapaxes(inverse, -1, -2)[:, None]
        return np.asarray(NOISE_REFERENCE * np.sqrt((sides**2).sum(axis=(-2, -1))))


def _fill_camera_columns(out: Array, points: Array) -> None:
    """Derivatives of points (N, J, 3) in x and y by rotation vector and log scale, to (N, 2, J, 4)."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    out[:, 0, :, 0], out[:, 1, :, 0] = 0.0, -z
    out[:, 0, :, 1], out[:, 1, :, 1] = z, 0.0
    out[:, 0, :, 2], out[:, 1, :, 2] = -y, x
    out[:, 0, :, 3], out[:, 1, :, 3] = x, y


def initial_state(problem: Problem, starts: Sequence[Start], s0: Array) -> State:
    """The batch's state at these starts, translations at the centroids of the image points."""
    theta = np.concatenate([s.theta for s in starts])
    rotation = np.concatenate([s.cameras.rotation for s in starts])
    scale = np.concatenate([s.cameras.scale / one for s, one in zip(starts, s0, strict=True)])
    return State(theta, rotation, np.log(scale), _centroids(problem.image, problem.weight))


def _centroids(image: Array, weight: Array) -> Array:
    total = np.maximum(weight.sum(axis=1), 1e-12)[:, None]
    return np.asarray((weight[..., None] * image).sum(axis=1) / total)
