"""The non-periodic model solved jointly: cameras and base-pose weights in one Levenberg-Marquardt.

It minimises the objective of `alternation` with two terms more,

    sum_tj w_tj rho(|s_t R_t[:2] P_tj + t_t - x_tj|^2 / s0^2)   reprojection; rho = Cauchy's loss, or none
  + beta   sum_tb (length_tb - mean_b)^2                        bone lengths (TPAMI 2016, eq. 20)
  + lambda sum_tl (theta_tl / sigma_l)^2                        Gaussian prior of the base poses
  + mu     sum_tl ((theta_tl - theta_(t-1)l) / sigma_l)^2 / dt  smoothness
  + gamma  sum_t  |M_t - M_(t-1)|^2 / dt                        flip regulariser (eq. 12), more for column 3

over all frames at once. All weights but the first are for an image noise of 10 mm; with `adapt_noise` they
grow and shrink with its variance, which is found from the residual in a few rounds, as the maximum of the
posterior demands. A frame has K weights, three rotation parameters and a log scale; its translation is
eliminated. The normal matrix is block tridiagonal, the mean bone lengths are eliminated exactly by a low-rank
correction, and any number of people and hypotheses are solved as one batch: their sequences stand one after
the other in the same arrays with no coupling across the seams.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.base_poses import BasePoses
from mocap_ros.block_tridiagonal import factor, solve_less_low_rank
from mocap_ros.camera import Cameras, small_rotation
from mocap_ros.config import SolverConfig
from mocap_ros.reconstruction import Reconstruction, Start, Window, begin, camera_hypotheses

Array = NDArray[np.float64]

CAMERA_UNKNOWNS = 4
FIRST_DAMPING, WARM_DAMPING = 0.1, 1e-4
LEAST_DAMPING, MOST_DAMPING = 1e-5, 1e8
ACCEPTED, REJECTED = 0.2, 10.0
SHORTEST_STEP = 1e-4

NOISE_REFERENCE = 0.01
NOISE_SCHEDULE = (0.05, 0.025, 0.012, 0.006, 0.003)
NOISE_ROUND_TOLERANCE = 0.05
WORTH_SOLVING = 0.3
FEWEST_COMPONENTS = 5
LEAST_FREE = 0.05


@dataclass(frozen=True, eq=False)
class State:
    """Unknowns of all frames: weights (N, K), rotation (N, 3, 3), log scale (N,), translation (N, 2)."""

    theta: Array
    rotation: Array
    log_scale: Array
    translation: Array

    def moved(self, step: Array) -> State:
        """The state after a step (N, K + 4) of weights, rotation vector and log scale."""
        k = self.theta.shape[1]
        return State(
            self.theta + step[:, :k],
            small_rotation(step[:, k : k + 3]) @ self.rotation,
            self.log_scale + np.clip(step[:, k + 3], -1, 1),
            self.translation,
        )

    def where(self, take: NDArray[np.bool_], other: State) -> State:
        """This state in the frames where `take` (N,), the other elsewhere."""
        return State(
            np.where(take[:, None], self.theta, other.theta),
            np.where(take[:, None, None], self.rotation, other.rotation),
            np.where(take, self.log_scale, other.log_scale),
            np.where(take[:, None], self.translation, other.translation),
        )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton's equations of a batch, the translations eliminated.

    Attributes:
        diagonal: (N, n, n); below: (N - 1, n, n); gradient: (N, n), halved like the matrix.
        bones: (N, n, B) gradients of the bone lengths times the root of their weights.
    """

    diagonal: Array
    below: Array
    gradient: Array
    bones: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """A batch of sequences, concatenated; image points in metres at the body (px / s0).

    Attributes:
        image: (N, J, 2).
        weight: (N, J) detector scores over `level`.
        level: (N,) variance of the noise over that of the reference.
        starts: (P,) first frame of each sequence.
        counts: (P,) frames of each.
        smooth: (N - 1,) weight of (change of theta / sigma)^2 to the next frame, 0 across a seam.
        flip: (N - 1, 3) weight of (change of M)^2 for each column of M, 0 across a seam.
        bone_weight: (B,).
        robust: (N, 1) m, scale of Cauchy's loss; infinite for least squares.
    """

    model: BasePoses
    image: Array
    weight: Array
    level: Array
    starts: NDArray[np.intp]
    counts: NDArray[np.intp]
    smooth: Array
    flip: Array
    prior: Array
    bone_weight: Array
    robust: Array
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
        lengths = np.linalg.norm(model.mean[children] - model.mean[parents], axis=-1)
        relative = (lengths.mean() / lengths) ** 2 if config.relative_bones else np.ones(len(lengths))
        flip, prior = np.full(3, config.flip_weight), config.prior_weight
        if model.upright:
            flip = config.upright_turn * flip + np.array([0, 0, config.tilt_weight])
            prior *= config.upright_prior
        return Problem(
            model=model,
            image=np.concatenate([w.points / s for w, s in zip(windows, s0, strict=True)]),
            weight=np.concatenate([w.weight for w in windows]),
            level=np.ones(len(times)),
            starts=starts,
            counts=counts,
            smooth=config.smooth_weight * inverse_dt,
            flip=inverse_dt[:, None] * flip,
            prior=prior / model.std**2,
            bone_weight=config.bone_weight * relative,
            robust=np.full((len(times), 1), config.robust_scale if config.robust_scale > 0 else np.inf),
            parents=parents,
            children=children,
        )

    def truncated(self, k: int) -> Problem:
        """The same batch with the first `k` base poses."""
        return replace(self, model=self.model.truncated(k), prior=self.prior[:k])

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

    def noise(self, state: State) -> Array:
        """(P,) m, standard deviation of a coordinate of a fully trusted point, from the residual.

        The sum of squares is shared among the coordinates less those that the unknowns have absorbed.
        """
        _, error = self._residual(state)
        loss = self.level[:, None] * self.weight * self._loss((error**2).sum(axis=-1))
        coordinates = 2 * self.per_sequence((self.weight > 0).sum(axis=1))
        free = coordinates - self.per_sequence(self._absorbed(state))
        return np.sqrt(self.per_sequence(loss.sum(axis=1)) / np.maximum(free, LEAST_FREE * coordinates + 1))

    def _absorbed(self, state: State) -> Array:
        """(N,) coordinates of a frame that its unknowns fit away, its neighbours held."""
        whole = self.normal_equations(state).diagonal
        held = replace(self, weight=np.zeros_like(self.weight)).normal_equations(state).diagonal
        n = whole.shape[1]
        kept = np.linalg.solve(whole + 1e-9 * np.eye(n), held)
        return np.asarray(2 + n - np.einsum('nii->n', kept))

    def per_sequence(self, per_frame: Array) -> Array:
        """(N, ...) -> (P, ...) sums over the frames of each sequence."""
        return np.asarray(np.add.reduceat(per_frame, self.starts, axis=0))

    def per_frame(self, per_sequence: Array) -> Array:
        """(P, ...) -> (N, ...), each sequence's value for all its frames."""
        return np.repeat(per_sequence, self.counts, axis=0)

    def _residual(self, state: State) -> tuple[Array, Array]:
        """(N, J, 3) scaled poses in the camera frame and (N, J, 2) reprojection errors, m."""
        poses = self.model.poses(state.theta)
        turned = np.exp(state.log_scale)[:, None, None] * (poses @ np.swapaxes(state.rotation, -1, -2))
        return turned, turned[..., :2] + state.translation[:, None] - self.image

    def _loss(self, squared: Array) -> Array:
        if np.isinf(self.robust[0, 0]):
            return squared
        return np.asarray(self.robust**2 * np.log1p(squared / self.robust**2))

    def _robust_weight(self, squared: Array) -> Array:
        return np.asarray(self.weight / (1 + squared / self.robust**2))

    def bones(self, theta: Array) -> tuple[Array, Array, Array]:
        """(N, B) lengths less their sequence's mean, (N, B, 3) unit vectors, (N, B) lengths; m."""
        poses = self.model.poses(theta)
        vector = poses[:, self.children] - poses[:, self.parents]
        length = np.maximum(np.linalg.norm(vector, axis=-1), 1e-9)
        mean = self.per_sequence(length) / self.counts[:, None]
        return length - self.per_frame(mean), vector / length[..., None], length

    def cost(self, state: State) -> Array:
        """(P,) value of the objective, m^2."""
        _, error = self._residual(state)
        frame = (self.weight * self._loss((error**2).sum(axis=-1))).sum(axis=1)
        deviation, _, _ = self.bones(state.theta)
        frame += (self.bone_weight * deviation**2).sum(axis=1)
        frame += (self.prior * state.theta**2).sum(axis=1)
        change = (np.diff(state.theta, axis=0) / self.model.std) ** 2
        frame[:-1] += self.smooth * change.sum(axis=1)
        m = np.exp(state.log_scale)[:, None, None] * state.rotation[:, :2]
        frame[:-1] += (self.flip * (np.diff(m, axis=0) ** 2).sum(axis=1)).sum(axis=1)
        return self.per_sequence(frame)

    def best_translation(self, state: State) -> State:
        """The state with each frame's translation at its weighted optimum (a step of the robust fit)."""
        _, error = self._residual(state)
        w = self._robust_weight((error**2).sum(axis=-1))
        total = np.maximum(w.sum(axis=1), 1e-12)[:, None]
        return replace(state, translation=state.translation - (w[..., None] * error).sum(axis=1) / total)

    def normal_equations(self, state: State) -> NormalEquations:
        """Everything of the second order that the step needs."""
        frames, k = state.theta.shape
        turned, error = self._residual(state)
        w = self._robust_weight((error**2).sum(axis=-1))
        joints = w.shape[1]
        n = k + CAMERA_UNKNOWNS

        # rows: x of all joints, y of all joints, then the bones
        jac = np.empty((frames, 2 * joints + len(self.parents), n))
        m = np.exp(state.log_scale)[:, None, None] * state.rotation[:, :2]
        basis = np.moveaxis(self.model.components, 0, -1)  # (J, 3, K)
        flat = np.swapaxes(basis, 0, 1).reshape(3, -1)
        data = jac[:, : 2 * joints].reshape(frames, 2, joints, n)
        data[..., :k] = (m.reshape(-1, 3) @ flat).reshape(frames, 2, joints, k)
        _fill_camera_columns(data[..., k:], turned)
        residual = np.swapaxes(error, 1, 2)  # (N, 2, J)

        total = np.maximum(w.sum(axis=1), 1e-12)
        column_sums = (w[:, None, None] @ data)[:, :, 0]  # (N, 2, n)
        error_sums = (w[:, None] * residual).sum(axis=2)  # (N, 2)
        root = np.sqrt(w)[:, None]
        weighted_residual = (root * residual).reshape(frames, -1)
        data *= root[..., None]

        deviation, unit, length = self.bones(state.theta)
        direction = basis[self.children] - basis[self.parents]  # (B, 3, K)
        bone_jac = np.swapaxes(np.swapaxes(unit, 0, 1) @ direction, 0, 1)  # (N, B, K)
        bone_root = np.sqrt(self.bone_weight)[:, None]
        jac[:, 2 * joints :, :k] = bone_root * bone_jac
        jac[:, 2 * joints :, k:] = 0.0

        transposed = np.swapaxes(jac, -1, -2)
        diagonal = transposed @ jac
        diagonal[:, :k, :k] += self._bone_curvature(deviation / length, bone_jac, direction)
        scaled_sums = column_sums / np.sqrt(total)[:, None, None]
        diagonal -= np.swapaxes(scaled_sums, -1, -2) @ scaled_sums
        rows = np.concatenate([weighted_residual, bone_root[:, 0] * deviation], axis=1)
        gradient = (transposed @ rows[..., None])[..., 0]
        gradient -= (np.swapaxes(column_sums, -1, -2) @ (error_sums / total[:, None])[..., None])[..., 0]

        below = np.zeros((frames - 1, n, n))
        self._add_prior_and_smoothness(state, diagonal, below, gradient)
        self._add_flip(state, diagonal, below, gradient)
        return NormalEquations(diagonal, below, gradient, transposed[..., 2 * joints :])

    def _bone_curvature(self, excess: Array, bone_jac: Array, direction: Array) -> Array:
        """(N, K, K) second derivatives of the lengths of bones that are too long, times their excess.

        Gauss-Newton leaves them out and then needs several times the steps. Those of bones too short are negative
        and stay out, so that the matrix remains positive definite.
        """
        frames, _, k = bone_jac.shape
        weight = self.bone_weight * np.maximum(excess, 0)
        squares = (np.swapaxes(direction, -1, -2) @ direction).reshape(len(direction), -1)
        across = (weight @ squares).reshape(frames, k, k)
        along = np.swapaxes(bone_jac * weight[..., None], -1, -2) @ bone_jac
        return np.asarray(across - along)

    def _add_prior_and_smoothness(self, state: State, diagonal: Array, below: Array, gradient: Array) -> None:
        k = state.theta.shape[1]
        inverse_variance = 1 / self.model.std**2
        stiffness = np.zeros(len(state.theta))
        stiffness[:-1] += self.smooth
        stiffness[1:] += self.smooth
        on_diagonal = np.einsum('nii->ni', diagonal)
        on_diagonal[:, :k] += self.prior + stiffness[:, None] * inverse_variance
        np.einsum('nii->ni', below)[:, :k] = -self.smooth[:, None] * inverse_variance
        pull = self.smooth[:, None] * np.diff(state.theta, axis=0) * inverse_variance
        gradient[:, :k] += self.prior * state.theta
        gradient[1:, :k] += pull
        gradient[:-1, :k] -= pull

    def _add_flip(self, state: State, diagonal: Array, below: Array, gradient: Array) -> None:
        k = state.theta.shape[1]
        columns = np.swapaxes(np.exp(state.log_scale)[:, None, None] * state.rotation, -1, -2)
        derivative = np.empty((len(columns), 2, 3, CAMERA_UNKNOWNS))
        _fill_camera_columns(derivative, columns)
        jac = derivative.reshape(len(columns), 6, CAMERA_UNKNOWNS)
        transposed = np.swapaxes(jac, -1, -2)
        m = np.swapaxes(columns[..., :2], 1, 2).reshape(len(columns), 6, 1)
        flip = np.tile(self.flip, 2)[..., None]  # rows of M, then its columns
        stiffness = np.zeros((len(columns), 6, 1))
        stiffness[:-1] += flip
        stiffness[1:] += flip
        diagonal[:, k:, k:] += transposed @ (stiffness * jac)
        below[:, k:, k:] = -transposed[1:] @ (flip * jac[:-1])
        pull = flip * np.diff(m, axis=0)
        gradient[1:, k:] += (transposed[1:] @ pull)[..., 0]
        gradient[:-1, k:] -= (transposed[:-1] @ pull)[..., 0]

    def step(self, equations: NormalEquations, damping: Array) -> Array | None:
        """(N, n) Levenberg-Marquardt step with (P,) relative damping; None where it cannot be had."""
        diagonal = equations.diagonal.copy()
        on_diagonal = np.einsum('nii->ni', diagonal)
        on_diagonal *= 1 + self.per_frame(damping)[:, None]
        on_diagonal += 1e-12
        n = diagonal.shape[1]
        banded = factor(diagonal, equations.below, n + CAMERA_UNKNOWNS - 1)
        if banded is None:
            return None
        return -solve_less_low_rank(banded, equations.gradient, equations.bones, 1 / self.counts, self.starts)


def _fill_camera_columns(out: Array, points: Array) -> None:
    """Derivatives of points (N, J, 3) in x and y by rotation vector and log scale, to (N, 2, J, 4)."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    out[:, 0, :, 0], out[:, 1, :, 0] = 0.0, -z
    out[:, 0, :, 1], out[:, 1, :, 1] = z, 0.0
    out[:, 0, :, 2], out[:, 1, :, 2] = -y, x
    out[:, 0, :, 3], out[:, 1, :, 3] = x, y


def solve(windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> tuple[Reconstruction, ...]:
    """Reconstruct many sequences as one batch.

    Args:
        windows: the sequences, each with its own start or None (mean pose and closed-form cameras).
        model: base poses, metric.
        config: weights of the terms.

    Returns:
        One reconstruction a window. The objective of each never rises; it is that of the last round of noise.

    Raises:
        InputError: a window without four seen joints in any frame.
    """
    model = model.truncated(config.components)
    begun = [begin(w, model, config.start_window) for w in windows]
    starts = [start for start, _ in begun]
    s0 = np.array([unit for _, unit in begun])
    problem = Problem.build(windows, s0, model, config)
    state = problem.best_translation(initial_state(problem, starts, s0))
    state = problem.best_translation(state)
    spent = 0
    if config.adapt_noise:
        problem, state, spent = _anneal(problem, state, windows, config)
    rest = replace(config, max_iterations=max(config.max_iterations - spent, 1))
    warm = spent > 0 or all(w.start is not None for w in windows)
    damping = WARM_DAMPING if warm else FIRST_DAMPING
    state, history, iterations, converged = _levenberg_marquardt(problem, state, rest, damping)
    return tuple(
        result(
            problem,
            i,
            window,
            s0[i],
            state,
            [float(h[i]) for h in history[: iterations[i] + 1]],
            bool(converged[i]),
        )
        for i, window in enumerate(windows)
    )


def solve_hypotheses(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> tuple[Reconstruction, ...]:
    """As `solve`, each window from `config.hypotheses` camera starts, all one batch; the likeliest result of each.

    With base poses of the right category this gains nothing over one start; the all-motions model needs the Necker
    reversal for people seen from the front or from behind (docs/solvers.md).
    """
    if config.hypotheses == 1:
        return solve(windows, model, config)
    batch = []
    for window in windows:
        start, unit = begin(window, model.truncated(config.components), config.start_window)
        tried = camera_hypotheses(start, config.hypotheses)
        batch += [replace(window, start=s, unit=unit) for s in tried]
    results = solve(batch, model, config)
    groups = [results[i : i + config.hypotheses] for i in range(0, len(results), config.hypotheses)]
    return tuple(min(group, key=lambda r: misfit(r, w, config)) for group, w in zip(groups, windows, strict=True))


def misfit(result: Reconstruction, window: Window, config: SolverConfig) -> float:
    """Minus twice the log posterior, up to a constant; comparable between results under different noise."""
    if not config.adapt_noise:
        return result.objective[-1] / NOISE_REFERENCE**2
    noise = max(result.noise, config.noise_floor)
    coordinates = 2 * int((window.weight > 0).sum())
    return result.objective[-1] / NOISE_REFERENCE**2 + 2 * coordinates * math.log(noise / NOISE_REFERENCE)


def _anneal(
    problem: Problem, state: State, windows: Sequence[Window], config: SolverConfig
) -> tuple[Problem, State, int]:
    """Find the noise of each window that does not say it, coming down from a large one.

    Under large noise the prior holds the weights, the cameras settle first, and few local minima are left. Base
    poses that vary less than the noise are not worth solving for yet.

    Returns:
        The problem under the noise found, the state, and how many steps it took.
    """
    noise = np.array([max(w.noise or NOISE_SCHEDULE[0], config.noise_floor) for w in windows])
    unknown = np.array([w.noise is None for w in windows])
    problem = problem.under_noise(noise)
    if not unknown.any():
        return problem, state, 0
    rough = replace(config, tolerance=max(NOISE_ROUND_TOLERANCE, config.tolerance))
    spent, damping = 0, FIRST_DAMPING
    for least in (*NOISE_SCHEDULE[1:], 0.0):
        k = max(int((problem.model.std >= WORTH_SOLVING * noise.min()).sum()), FEWEST_COMPONENTS)
        coarse = replace(state, theta=state.theta[:, :k])
        coarse, history, _, _ = _levenberg_marquardt(problem.truncated(k), coarse, rough, damping)
        state = replace(coarse, theta=np.concatenate([coarse.theta, state.theta[:, k:]], axis=1))
        damping = WARM_DAMPING
        spent += len(history) - 1
        found = np.maximum(problem.noise(state), max(least, config.noise_floor))
        noise = np.where(unknown, found, noise)
        problem = problem.under_noise(noise)
    return problem, state, spent


def initial_state(problem: Problem, starts: Sequence[Start], s0: Array) -> State:
    """The batch's state at these starts, translations at the centroids of the image points."""
    theta = np.concatenate([s.theta for s in starts])
    rotation = np.concatenate([s.cameras.rotation for s in starts])
    scale = np.concatenate([s.cameras.scale / one for s, one in zip(starts, s0, strict=True)])
    return State(theta, rotation, np.log(scale), _centroids(problem.image, problem.weight))


def _centroids(image: Array, weight: Array) -> Array:
    total = np.maximum(weight.sum(axis=1), 1e-12)[:, None]
    return np.asarray((weight[..., None] * image).sum(axis=1) / total)


def _levenberg_marquardt(
    problem: Problem, state: State, config: SolverConfig, first_damping: float
) -> tuple[State, list[Array], NDArray[np.intp], NDArray[np.bool_]]:
    """Each sequence has its own damping and its own end; all of them step together."""
    sequences = len(problem.starts)
    cost = problem.cost(state)
    history = [cost]
    damping = np.full(sequences, first_damping)
    done = np.zeros(sequences, bool)
    taken = np.zeros(sequences, int)
    equations = problem.normal_equations(state)
    for _ in range(config.max_iterations):
        step = problem.step(equations, damping)
        if step is None:
            damping = np.where(done, damping, damping * REJECTED)
            continue
        tried = problem.best_translation(state.moved(step))
        new = problem.cost(tried)
        better = ~done & (new < cost)
        gained = np.where(better, cost - new, 0.0)
        state = tried.where(np.repeat(better, problem.counts), state)
        cost = np.where(better, new, cost)
        history.append(cost)
        taken += ~done
        done |= (better & (gained <= config.tolerance * cost)) | (damping > MOST_DAMPING)
        factor_ = np.where(better, ACCEPTED, REJECTED)
        damping = np.where(done, damping, np.maximum(damping * factor_, LEAST_DAMPING))
        if done.all():
            break
        if better.any():
            equations = problem.normal_equations(state)
    return state, history, taken, done


def result(
    problem: Problem,
    sequence: int,
    window: Window,
    unit: float,
    state: State,
    history: Sequence[float],
    converged: bool,
) -> Reconstruction:
    """The reconstruction of one sequence of a batch, `unit` px/m, `history` its objective from the start on."""
    start = problem.starts[sequence]
    own = slice(start, start + problem.counts[sequence])
    poses = problem.model.poses(state.theta[own])
    rotation = state.rotation[own]
    turned = poses @ np.swapaxes(rotation, -1, -2)
    cameras = Cameras(np.exp(state.log_scale[own]) * unit, rotation)
    translation = state.translation[own] * unit
    error = cameras.scale[:, None, None] * turned[..., :2] + translation[:, None] - window.points
    seen = window.weight > 0
    with np.errstate(invalid='ignore'):
        residual = np.sqrt((seen[..., None] * error**2).sum(axis=(1, 2)) / seen.sum(axis=1))
    return Reconstruction(
        joints=turned,
        theta=state.theta[own],
        cameras=cameras,
        translation=translation,
        residual=residual,
        objective=tuple(history),
        iterations=len(history) - 1,
        converged=converged,
        noise=float(problem.noise(state)[sequence]),
    )
