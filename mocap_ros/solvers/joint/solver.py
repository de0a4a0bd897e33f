"""The non-periodic model solved jointly: cameras and base-pose weights in one Levenberg-Marquardt.

It minimises `objective` over all frames of any number of people and hypotheses at once, each with its own damping
and its own end. The image noise, by which the weights of the terms scale, is found on the way, from a large one
down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import rotation_vector, small_rotation
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.block_banded import Factor
from mocap_ros.solvers.joint.lifted_pose import lifted_start
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE, SHORTEST_STEP, Problem, initial_state
from mocap_ros.solvers.joint.state import Fit, NormalEquations, State
from mocap_ros.solvers.window import Reconstruction, Window, begin, camera_hypotheses

Array = NDArray[np.float64]

FIRST_DAMPING, NEXT_DAMPING, WARM_DAMPING = 0.1, 1e-4, 1e-2
LEAST_DAMPING, MOST_DAMPING = 1e-5, 1e8
ACCEPTED, REJECTED = 0.2, 10.0

COARSE_NOISE, FINE_NOISE = (0.05, 0.025, 0.012), (0.006, 0.003)
COARSE_STEP = 0.1
NOISE_ROUND_TOLERANCE = 0.05
WORTH_SOLVING = 0.3
FEWEST_COMPONENTS = 5


def solve(windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> tuple[Reconstruction, ...]:
    """Reconstruct many sequences as one batch.

    Args:
        windows: the sequences, each with its own start or None (the lifted poses, or where there are none the mean
            pose and closed-form cameras).
        model: base poses, metric.
        config: weights of the terms.

    Returns:
        One reconstruction a window. The objective of each never rises; it is that of the last round of noise.

    Raises:
        InputError: a window without four seen joints in any frame, or only some of the windows lifted.
    """
    model = model.truncated(config.components)
    warm = all(w.start is not None and (w.noise is not None or not config.adapt_noise) for w in windows)
    windows = [from_lifted(w, model) for w in windows]
    begun = [begin(w, model, config.start_window) for w in windows]
    starts = [start for start, _ in begun]
    s0 = np.array([unit for _, unit in begun])
    problem = Problem.build(windows, s0, model, config)
    state = problem.settled(initial_state(problem, starts, s0)).state
    if not warm:
        state = problem.settled(state).state
    damping = FIRST_DAMPING
    if config.adapt_noise:
        problem, state = _anneal(problem, state, windows, config)
        damping = NEXT_DAMPING
    if warm:
        damping = WARM_DAMPING
    descent = _levenberg_marquardt(problem, state, config, damping)
    return results(problem, windows, s0, descent)


def solve_hypotheses(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> tuple[Reconstruction, ...]:
    """As `solve`, each window from several camera starts, all one batch; the likeliest result of each.

    There are `config.hypotheses` starts, or `config.heading_hypotheses` for a model aligned by heading: with base
    poses of the right category more than one gains nothing; the all-motions model needs the Necker reversal for
    people seen from the front or from behind (docs/solvers.md). Lifted poses are a start that needs no others.
    """
    count = config.heading_hypotheses if model.upright else config.hypotheses
    if all(w.lifted is not None for w in windows):
        count = 1
    if count == 1:
        return solve(windows, model, config)
    batch: list[Window] = []
    for window in windows:
        start, unit = begin(window, model.truncated(config.components), config.start_window)
        batch += [replace(window, start=s, unit=unit) for s in camera_hypotheses(start, count)]
    found = solve(batch, model, config)
    groups = [found[i : i + count] for i in range(0, len(found), count)]
    return tuple(min(group, key=lambda r: misfit(r, w, config)) for group, w in zip(groups, windows, strict=True))


def from_lifted(window: Window, model: BasePoses) -> Window:
    """The window with a start from its lifted poses, if it has these and no start."""
    if window.start is not None or window.lifted is None:
        return window
    return replace(window, start=lifted_start(window.lifted, window, model))


def misfit(result: Reconstruction, window: Window, config: SolverConfig) -> float:
    """Minus twice the log posterior, up to a constant; comparable between results under different noise."""
    if not config.adapt_noise:
        return result.objective[-1] / NOISE_REFERENCE**2
    noise = max(result.noise, config.noise_floor)
    coordinates = 2 * int((window.weight > 0).sum())
    return result.objective[-1] / NOISE_REFERENCE**2 + 2 * coordinates * math.log(noise / NOISE_REFERENCE)


def _anneal(
    problem: Problem, state: State, windows: Sequence[Window], config: SolverConfig
) -> tuple[Problem, State]:
    """Find the noise of each window that does not say it, coming down from a large one.

    Under large noise the prior holds the weights, the cameras settle first, and few local minima are left. Base
    poses that vary less than the noise are not worth solving for yet, nor are all frames.

    Returns:
        The problem under the noise found, and the state.
    """
    noise = np.array([max(w.noise or COARSE_NOISE[0], config.noise_floor) for w in windows])
    unknown = np.array([w.noise is None for w in windows])
    if not unknown.any():
        return problem.under_noise(noise), state

    def found(least: float, descent: Descent) -> Array:
        new = problem_.noise(descent.fit, descent.equations)
        return np.where(unknown, np.maximum(new, max(least, config.noise_floor)), noise)

    rough = replace(config, tolerance=max(NOISE_ROUND_TOLERANCE, config.tolerance))
    few, kept = problem.thinned(COARSE_STEP)
    coarse = state.take(kept)
    damping = FIRST_DAMPING
    for level, least in zip(COARSE_NOISE, (*COARSE_NOISE[1:], FINE_NOISE[0]), strict=True):
        k = max(int((problem.model.std >= WORTH_SOLVING * level).sum()), FEWEST_COMPONENTS)
        problem_ = few.under_noise(noise).truncated(k)
        descent = _levenberg_marquardt(problem_, coarse.truncated(k), rough, damping)
        coarse = coarse.with_first(descent.fit.state)
        noise = found(least, descent)
        damping = NEXT_DAMPING
    state = problem.settled(interpolated(coarse, kept, problem)).state
    for least in (*FINE_NOISE[1:], 0.0):
        problem_ = problem.under_noise(noise)
        descent = _levenberg_marquardt(problem_, state, rough, damping)
        state, before = descent.fit.state, noise
        noise = found(least, descent)
        if np.array_equal(noise, before):
            break
    return problem.under_noise(noise), state


def interpolated(coarse: State, kept: NDArray[np.intp], problem: Problem) -> State:
    """The state of all frames of `problem` from that of the frames `kept`, interpolated in time."""
    sequence = np.repeat(np.arange(len(problem.starts)), problem.counts)
    every = np.arange(len(sequence))
    after = np.minimum(np.searchsorted(kept, every), len(kept) - 1)
    before = np.maximum(np.searchsorted(kept, every, side='right') - 1, 0)
    own = sequence[kept]
    before = np.where(own[before] == sequence, before, after)
    after = np.where(own[after] == sequence, after, before)
    t, t0, t1 = problem.times, problem.times[kept[before]], problem.times[kept[after]]
    f = np.clip((t - t0) / np.maximum(t1 - t0, SHORTEST_STEP), 0.0, 1.0)
    first, last = coarse.take(before), coarse.take(after)
    turn = rotation_vector(last.rotation @ np.swapaxes(first.rotation, -1, -2))
    return State(
        first.theta + f[:, None] * (last.theta - first.theta),
        small_rotation(f[:, None] * turn) @ first.rotation,
        first.log_scale + f * (last.log_scale - first.log_scale),
        first.translation + f[:, None] * (last.translation - first.translation),
    )


@dataclass(frozen=True, eq=False)
class Descent:
    """Where Levenberg-Marquardt ended.

    Attributes:
        equations: of the last state but one, or of the last; banded: their factored matrix.
        objective: (P,) after each step, the start first.
        iterations: (P,) steps of each sequence; converged: (P,).
    """

    fit: Fit
    equations: NormalEquations
    banded: Factor | None
    objective: list[Array]
    iterations: NDArray[np.intp]
    converged: NDArray[np.bool_]


def _levenberg_marquardt(problem: Problem, state: State, config: SolverConfig, first_damping: float) -> Descent:
    """Each sequence has its own damping and its own end; all of them step together."""
    sequences = len(problem.starts)
    here = problem.fit(state)
    cost = problem.cost(here)
    history = [cost]
    damping = np.full(sequences, first_damping)
    done = np.zeros(sequences, bool)
    taken = np.zeros(sequences, int)
    equations = problem.normal_equations(here)
    stale = False
    banded = None
    for _ in range(config.max_iterations):
        if stale:
            equations, stale = problem.normal_equations(here).frozen(problem.per_frame(done), equations), False
        solved = problem.step(equations, damping)
        if solved is None:
            damping = np.where(done, damping, damping * REJECTED)
            continue
        step, banded = solved
        tried = problem.settled(here.state.moved(step))
        new = problem.cost(tried)
        better = ~done & (new < cost)
        gained = np.where(better, cost - new, 0.0)
        if better.all():
            here = tried
        elif better.any():
            here = problem.fit(tried.state.where(problem.per_frame(better), here.state))
        cost = np.where(better, new, cost)
        history.append(cost)
        taken += ~done
        done |= (better & (gained <= config.tolerance * cost)) | (damping > MOST_DAMPING)
        factor_ = np.where(better, ACCEPTED, REJECTED)
        damping = np.where(done, damping, np.maximum(damping * factor_, LEAST_DAMPING))
        if done.all():
            break
        stale = bool(better.any())
    return Descent(here, equations, banded, history, taken, done)


def results(
    problem: Problem, windows: Sequence[Window], units: Array, descent: Descent
) -> tuple[Reconstruction, ...]:
    """The reconstruction of each sequence of a batch; units (P,) px/m."""
    noise = problem.noise(descent.fit, descent.equations)
    spread = None if descent.banded is None else problem.spread(descent.fit, descent.banded)
    return tuple(
        result(
            problem,
            i,
            window,
            units[i],
            descent.fit,
            [float(h[i]) for h in descent.objective[: descent.iterations[i] + 1]],
            bool(descent.converged[i]),
            float(noise[i]),
            None if spread is None else spread[i],
        )
        for i, window in enumerate(windows)
    )


def result(
    problem: Problem,
    sequence: int,
    window: Window,
    unit: float,
    fit: Fit,
    history: Sequence[float],
    converged: bool,
    noise: float,
    spread: Array | None = None,
) -> Reconstruction:
    """The reconstruction of one sequence of a batch, `unit` px/m, `history` its objective from the start on."""
    own = slice(problem.starts[sequence], problem.starts[sequence] + problem.counts[sequence])
    scale = np.exp(fit.state.log_scale[own])
    joints = fit.turned[own] / scale[:, None, None]
    seen = window.weight > 0
    with np.errstate(invalid='ignore'):
        residual = unit * np.sqrt((seen * fit.squared[own]).sum(axis=1) / seen.sum(axis=1))
    return Reconstruction(
        joints=joints,
        theta=fit.state.theta[own],
        cameras=Cameras(scale * unit, fit.state.rotation[own]),
        translation=fit.state.translation[own] * unit,
        residual=residual,
        objective=tuple(history),
        iterations=len(history) - 1,
        converged=converged,
        noise=noise,
        spread=np.full(joints.shape[1], np.nan) if spread is None else spread,
    )
