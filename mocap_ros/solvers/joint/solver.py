"""The non-periodic model solved jointly for cameras and base-pose weights (TPAMI 2016, section 3.4).

The paper alternates between cameras and weights (`alternation`). Here one Levenberg-Marquardt minimises
`objective` over both at once, for any number of people and hypotheses in one batch. The image noise, which the
weights of the terms are relative to, is found on the way (`noise_annealing`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.levenberg_marquardt import Descent, minimise_stepwise
from mocap_ros.solvers.joint.lifted_pose import fit_initial_values
from mocap_ros.solvers.joint.noise_annealing import COLD_DAMPING, CONTINUED_DAMPING, anneal_stepwise
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE, JointObjective
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.stepwise import Stepwise, run_to_end
from mocap_ros.solvers.window import (
    Reconstruction,
    SolverStatus,
    Window,
    choose_initial_values,
    reverse_depth,
)

Array = NDArray[np.float64]

WARM_DAMPING = 1e-2  # first damping from the solution of the last frame; tuned on live walks and runs


@dataclass(frozen=True, eq=False)
class JointReconstruction(Reconstruction):
    """Reconstruction by the joint solver. Its objective never rises.

    Attributes:
        noise: m, standard deviation of a coordinate of a point of weight 1, estimated from the residual.
        joint_std: (J,) m, posterior standard deviation (root of the trace of the covariance) of each joint of the
            last frame relative to the origin of the body frame; None where the equations are singular.
    """

    noise: float
    joint_std: Array | None


def solve(windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> tuple[JointReconstruction, ...]:
    """Reconstruct many sequences as one batch.

    Args:
        windows: the sequences. A window without initial values starts from its lifted poses or, without these,
            from the mean pose and closed-form cameras.
        model: base poses, metric.
        config: weights of the terms, and when the solver stops.

    Returns:
        One reconstruction for each window.

    Raises:
        InputError: no frame of a window has four seen joints, or only some of the windows have lifted poses.
    """
    return run_to_end(solve_stepwise(windows, model, config))


def solve_stepwise(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> Stepwise[tuple[JointReconstruction, ...]]:
    """Reconstruct as `solve` does, in steps."""
    model = model.truncate(config.components)
    is_warm = all(w.start is not None and (w.noise is not None or not config.adapt_noise) for w in windows)
    windows = [start_from_lifted_poses(w, model) for w in windows]
    chosen = [choose_initial_values(w, model, config.start_window) for w in windows]
    yield
    starts = [start for start, _ in chosen]
    units = np.array([unit for _, unit in chosen])
    objective = JointObjective.build(windows, units, model, config)
    state = objective.with_optimal_translation(objective.initial_state(starts, units)).state
    if not is_warm:
        state = objective.with_optimal_translation(state).state
    yield
    damping = COLD_DAMPING
    earlier_iterations = np.zeros(len(windows), int)
    if config.adapt_noise:
        objective, state, earlier_iterations = yield from anneal_stepwise(objective, state, windows, config)
        damping = CONTINUED_DAMPING
    if is_warm:
        damping = WARM_DAMPING
    descent = yield from minimise_stepwise(objective, state, config, damping)
    yield
    return _make_reconstructions(objective, windows, units, descent, earlier_iterations)


def solve_hypotheses(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> tuple[JointReconstruction, ...]:
    """Reconstruct each window from one or two initial cameras, all in one batch, and return the likelier results.

    The second camera is the Necker reversal of the first. `config.hypotheses` is the number of cameras, or
    `config.heading_hypotheses` for base poses that were aligned by heading. With base poses of the right category
    the second gains nothing; those of all motions need it for people seen from the front or from behind
    (docs/solvers.md). Lifted poses already tell the front from the back, so that one start is enough.

    Args:
        windows: the sequences.
        model: base poses, metric.
        config: as for `solve`.
    """
    return run_to_end(solve_hypotheses_stepwise(windows, model, config))


def solve_hypotheses_stepwise(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> Stepwise[tuple[JointReconstruction, ...]]:
    """Reconstruct as `solve_hypotheses` does, in steps."""
    count = config.heading_hypotheses if model.aligned_by_heading else config.hypotheses
    if all(w.lifted is not None for w in windows):
        count = 1
    if count == 1:
        return (yield from solve_stepwise(windows, model, config))
    batch: list[Window] = []
    for window in windows:
        start, unit = choose_initial_values(window, model.truncate(config.components), config.start_window)
        batch += [replace(window, start=s, unit=unit) for s in (start, reverse_depth(start))]
        yield
    results = yield from solve_stepwise(batch, model, config)
    return tuple(
        min(pair, key=lambda r: negative_log_posterior(r, w, config))
        for pair, w in zip(zip(results[::2], results[1::2], strict=True), windows, strict=True)
    )


def start_from_lifted_poses(window: Window, model: BasePoses) -> Window:
    """Return the window with initial values from its lifted poses, if it has such poses and no initial values."""
    if window.start is not None or window.lifted is None:
        return window
    return replace(window, start=fit_initial_values(window.lifted, window, model))


def negative_log_posterior(result: JointReconstruction, window: Window, config: SolverConfig) -> float:
    """Return minus twice the log posterior, up to a constant; it compares results under different noise."""
    if not config.adapt_noise:
        return result.cost / NOISE_REFERENCE**2
    noise = max(result.noise, config.noise_floor)
    coordinates = 2 * int((window.weight > 0).sum())
    return result.cost / NOISE_REFERENCE**2 + 2 * coordinates * math.log(noise / NOISE_REFERENCE)


def _make_reconstructions(
    objective: JointObjective,
    windows: Sequence[Window],
    units: Array,
    descent: Descent,
    earlier_iterations: NDArray[np.intp],
) -> tuple[JointReconstruction, ...]:
    """Return the reconstruction of each sequence of a batch; units (P,) px/m."""
    noise = objective.estimate_noise(descent.fit, descent.equations)
    joint_std = None if descent.banded is None else objective.joint_std(descent.fit, descent.banded)
    out = []
    for i, window in enumerate(windows):
        status, iterations = SolverStatus(descent.status[i]), descent.iterations[i]
        history = [float(values[i]) for values in descent.objective[: iterations + 1]]
        total = int(earlier_iterations[i] + iterations)
        result = make_reconstruction(objective, i, window, units[i], descent.fit, status, history, total)
        std = None if joint_std is None else joint_std[i]
        out.append(JointReconstruction(**vars(result), noise=float(noise[i]), joint_std=std))
    return tuple(out)


def make_reconstruction(
    objective: JointObjective,
    sequence: int,
    window: Window,
    unit: float,
    fit: Fit,
    status: SolverStatus,
    history: Sequence[float],
    iterations: int,
) -> Reconstruction:
    """Return the reconstruction of one sequence of a batch.

    Args:
        objective: of the batch.
        sequence: index of the sequence in the batch.
        window: that sequence.
        unit: px/m, by which its image points were divided.
        fit: of the final state of the batch.
        status: why the solver stopped.
        history: m^2, objective of the sequence at the start and after each step.
        iterations: number of steps that were tried.
    """
    first = objective.batch.starts[sequence]
    own = slice(first, first + objective.batch.counts[sequence])
    scale = np.exp(fit.state.log_scale[own])
    joints = fit.scaled_poses[own] / scale[:, None, None]
    seen = window.weight > 0
    with np.errstate(invalid='ignore'):
        residual = unit * np.sqrt((seen * fit.squared_error[own]).sum(axis=1) / seen.sum(axis=1))
    return Reconstruction(
        joints=joints,
        theta=fit.state.theta[own],
        cameras=WeakPerspectiveCameras(scale * unit, fit.state.rotation[own]),
        translation=fit.state.translation[own] * unit,
        residual=residual,
        status=status,
        history=tuple(history),
        iterations=iterations,
    )
