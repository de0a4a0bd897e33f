"""The non-periodic model solved jointly for cameras and base-pose weights (TPAMI 2016, section 3.4).

The paper alternates between cameras and weights (`alternation`). Here one Levenberg-Marquardt minimises
`objective` over both at once, for any number of people and hypotheses in one batch. The image noise, which the
weights of the terms are relative to, is found on the way (`noise_annealing`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.joint.levenberg_marquardt import Descent, minimise
from mocap_ros.solvers.joint.lifted_pose import fit_initial_values
from mocap_ros.solvers.joint.noise_annealing import COLD_DAMPING, CONTINUED_DAMPING, anneal
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE, JointObjective
from mocap_ros.solvers.joint.state import Fit
from mocap_ros.solvers.window import Reconstruction, Window, choose_initial_values, make_camera_hypotheses

Array = NDArray[np.float64]

WARM_DAMPING = 1e-2  # first damping from the solution of the last frame; tuned on live walks and runs


def solve(windows: Sequence[Window], model: BasePoses, config: SolverConfig) -> tuple[Reconstruction, ...]:
    """Reconstruct many sequences as one batch.

    Args:
        windows: the sequences. A window without initial values starts from its lifted poses or, without these,
        from
            the mean pose and closed-form cameras.
        model: base poses, metric.
        config: weights of the terms, and when the solver stops.

    Returns:
        One reconstruction for each window. Its objective never rises; it is that of the last round of noise.

    Raises:
        InputError: no frame of a window has four seen joints, or only some of the windows have lifted poses.
    """
    model = model.truncate(config.components)
    is_warm = all(w.start is not None and (w.noise is not None or not config.adapt_noise) for w in windows)
    windows = [start_from_lifted_poses(w, model) for w in windows]
    chosen = [choose_initial_values(w, model, config.start_window) for w in windows]
    starts = [start for start, _ in chosen]
    units = np.array([unit for _, unit in chosen])
    objective = JointObjective.build(windows, units, model, config)
    state = objective.with_optimal_translation(objective.initial_state(starts, units)).state
    if not is_warm:
        state = objective.with_optimal_translation(state).state
    damping = COLD_DAMPING
    if config.adapt_noise:
        objective, state = anneal(objective, state, windows, config)
        damping = CONTINUED_DAMPING
    if is_warm:
        damping = WARM_DAMPING
    descent = minimise(objective, state, config, damping)
    return _make_reconstructions(objective, windows, units, descent)


def solve_hypotheses(
    windows: Sequence[Window], model: BasePoses, config: SolverConfig
) -> tuple[Reconstruction, ...]:
    """Reconstruct each window from several initial cameras, all in one batch, and return the most likely results.

    There are `config.hypotheses` initial cameras, or `config.heading_hypotheses` for base poses that were aligned
    by heading. With base poses of the right category more than one gains nothing; those of all motions need the
    Necker reversal for people seen from the front or from behind (docs/solvers.md). Lifted poses already tell the
    front from the back, so that one start is enough.

    Args:
        windows: the sequences.
        model: base poses, metric.
        config: as for `solve`.
    """
    count = config.heading_hypotheses if model.aligned_by_heading else config.hypotheses
    if all(w.lifted is not None for w in windows):
        count = 1
    if count == 1:
        return solve(windows, model, config)
    batch: list[Window] = []
    for window in windows:
        start, unit = choose_initial_values(window, model.truncate(config.components), config.start_window)
        batch += [replace(window, start=s, unit=unit) for s in make_camera_hypotheses(start, count)]
    results = solve(batch, model, config)
    groups = [results[i : i + count] for i in range(0, len(results), count)]
    return tuple(
        min(group, key=lambda r: negative_log_posterior(r, w, config))
        for group, w in zip(groups, windows, strict=True)
    )


def start_from_lifted_poses(window: Window, model: BasePoses) -> Window:
    """Return the window with initial values from its lifted poses, if it has such poses and no initial values."""
    if window.start is not None or window.lifted is None:
        return window
    return replace(window, start=fit_initial_values(window.lifted, window, model))


def negative_log_posterior(result: Reconstruction, window: Window, config: SolverConfig) -> float:
    """Return minus twice the log posterior, up to a constant; it compares results under different noise."""
    if not config.adapt_noise:
        return result.objective[-1] / NOISE_REFERENCE**2
    noise = max(result.noise, config.noise_floor)
    coordinates = 2 * int((window.weight > 0).sum())
    return result.objective[-1] / NOISE_REFERENCE**2 + 2 * coordinates * math.log(noise / NOISE_REFERENCE)


def _make_reconstructions(
    objective: JointObjective, windows: Sequence[Window], units: Array, descent: Descent
) -> tuple[Reconstruction, ...]:
    """Return the reconstruction of each sequence of a batch; units (P,) px/m."""
    noise = objective.estimate_noise(descent.fit, descent.equations)
    joint_std = None if descent.banded is None else objective.joint_std(descent.fit, descent.banded)
    return tuple(
        make_reconstruction(
            objective,
            i,
            window,
            units[i],
            descent.fit,
            [float(values[i]) for values in descent.objective[: descent.iterations[i] + 1]],
            bool(descent.converged[i]),
            float(noise[i]),
            None if joint_std is None else joint_std[i],
        )
        for i, window in enumerate(windows)
    )


def make_reconstruction(
    objective: JointObjective,
    sequence: int,
    window: Window,
    unit: float,
    fit: Fit,
    history: Sequence[float],
    converged: bool,
    noise: float,
    joint_std: Array | None = None,
) -> Reconstruction:
    """Return the reconstruction of one sequence of a batch.

    Args:
        objective: of the batch.
        sequence: index of the sequence in the batch.
        window: that sequence.
        unit: px/m, by which its image points were divided.
        fit: of the final state of the batch.
        history: m^2, objective of the sequence at the start and after each step.
        converged: whether the solver ended by itself.
        noise: m, image noise.
        joint_std: (J,) m, posterior standard deviation of the last frame's joints; None where it is not known.
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
        objective=tuple(history),
        iterations=len(history) - 1,
        converged=converged,
        noise=noise,
        joint_std=np.full(joints.shape[1], np.nan) if joint_std is None else joint_std,
    )
