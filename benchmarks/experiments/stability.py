# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Convergence, noisy initial values, occlusion and image noise (figures 12 to 18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from common import View
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from panels import TRUTH, draw_curves, draw_weights, label_axes, make_panels
from report import Report

from experiments.methods import ALGORITHM_1, JOINT, PERIODIC, SINES, Method, choose_few_headings
from experiments.variants.heading_ring import solve_from_ring
from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.geometry.weak_perspective import (
    CameraStepObjective,
    WeakPerspectiveCameras,
    fit_cameras_closed_form,
    run_camera_step,
    subtract_weighted_centroid,
)
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers import alternation, joint, periodic
from mocap_ros.solvers.window import InitialValues, Reconstruction, Window, choose_initial_values
from mocap_ros.viewing.plots import draw_bones, project_from_side

Array = NDArray[np.float64]

# Subjects and categories of the sequences of figures 12 and 13, as in the paper.
SUBJECTS = ('07', '09', '13', '16', '35')
CATEGORIES = ('walk', 'run', 'jump')
HEADING = 45  # degrees, direction of the views where only one is used
BEHIND = 180  # degrees, direction of a view from behind
# Joints that are hidden in figures 14 and 15.
ARM = ('lshoulder', 'lelbow', 'lwrist')
LEGS = ('lknee', 'lankle', 'rknee', 'rankle')
# The solvers in the tables of disturbances, with values of their configurations; np means non-periodic.
SOLVERS: Mapping[str, tuple[Method, Mapping[str, Any]]] = {
    'np, Algorithm 1': (ALGORITHM_1, {'tolerance': 1e-3}),
    'np, joint': (JOINT, {}),
    "periodic, the paper's sines": (SINES, {}),
    'periodic, project': (PERIODIC, {}),
}


def list_sequences(quick: bool) -> list[tuple[str, str]]:
    """List the walks, runs and jumps of the paper's five subjects as (trial, category)."""
    found = [
        (t.name, t.category) for t in common.list_trials() if t.subject in SUBJECTS and t.category in CATEGORIES
    ]
    return found[::36] if quick else found


def measure_convergence(report: Report, quick: bool) -> dict[str, Any]:
    """Convergence (figure 12)."""
    steps = 4 if quick else 10
    curves: dict[str, list[Array]] = {'Algorithm 1': [], 'joint': [], 'periodic': []}
    for index, (trial, category) in enumerate(common.show_progress(list_sequences(quick), 'convergence')):
        (view,) = common.make_views(trial, [HEADING])
        paper, ours = (m.train(category, trial) for m in (ALGORITHM_1, JOINT))
        curves['Algorithm 1'].append(measure_half_steps(view, paper, ALGORITHM_1.configure(), steps))
        if index % 2 == 0:
            curves['joint'].append(measure_joint_iterations(view, ours, steps))
        if index % 4 == 0 and category != 'jump':
            curves['periodic'].append(measure_periodic_iterations(view, ours, steps))
    data = {n: {'mean': np.mean(v, axis=0), 'std': np.std(v, axis=0)} for n, v in curves.items()}
    rows = []
    figure, axes = make_panels(3, sharey=True)
    for ax, method in zip(axes, (ALGORITHM_1, JOINT, PERIODIC), strict=True):
        name, mean, spread = method.name, *data[method.name].values()
        before = ['-'] if name == 'periodic' else []
        shown = range(0, len(mean), 2 if name == 'Algorithm 1' else 1)
        rows.append([name, *before, *(f'{mean[i]:.1f} ± {spread[i]:.1f}' for i in shown)])
        x = np.arange(len(mean)) + (name == 'periodic')
        ax.fill_between(x, mean - spread, mean + spread, color=method.colour, alpha=0.2, linewidth=0)
        ax.plot(x, mean, 'o-', color=method.colour)
        unit = 'half steps' if name == 'Algorithm 1' else 'iterations'
        label_axes(ax, unit, '2D error, mm' if ax is axes[0] else '', name)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes[0].set_ylim(bottom=0)
    report.table(['iterations', *map(str, range(steps + 1))], rows)
    rises = np.diff(np.array(curves['Algorithm 1']), axis=1)
    report.text(
        f"""The 2D error of Algorithm 1 rose in {(rises > 1e-3).sum()} of {rises.size} half steps, by
        at most {max(rises.max(), 0):.2f} mm. The paper reports no rise."""
    )
    report.paper_figure('fig12_convergence', figure, '2D error by iteration, mean and standard deviation')
    return data


def measure_half_steps(view: View, model: BasePoses, config: SolverConfig, steps: int) -> Array:
    """Return the 2D error of Algorithm 1 at the start and after every half step, (2 steps + 1,) mm."""
    model = model.truncate(config.components)
    start, unit = choose_initial_values(view.window, model, config.start_window)
    one = replace(config, max_iterations=1, tolerance=0.0)
    flip = config.flip_weight / np.diff(view.window.times)
    errors: list[float] = []
    for _ in range(steps):
        problem, cameras = _make_camera_step(view, model, start, unit, flip)
        if not errors:
            errors.append(_to_rms_mm(problem.data_cost(cameras), view, unit))
        errors.append(_to_rms_mm(problem.data_cost(run_camera_step(problem, cameras)), view, unit))
        result = alternation.reconstruct(replace(view.window, start=start, unit=unit), model, one)
        start = InitialValues(result.theta, result.cameras)
        errors.append(common.compute_residual_mm(view, result))
    return np.array(errors)


def _make_camera_step(
    view: View, model: BasePoses, start: InitialValues, unit: float, flip: Array
) -> tuple[CameraStepObjective, WeakPerspectiveCameras]:
    """Return the objective of the cameras with the poses of the initial values, and the cameras of these, m."""
    image, _ = subtract_weighted_centroid(view.window.points / unit, view.window.weight)
    body, _ = subtract_weighted_centroid(model.poses(start.theta), view.window.weight)
    cameras = WeakPerspectiveCameras(start.cameras.scale / unit, start.cameras.rotation)
    return CameraStepObjective(body, image, view.window.weight, flip), cameras


def _to_rms_mm(cost: Array, view: View, unit: float) -> float:
    """Convert squared errors in m at the initial scale to the root mean square in mm at the true scale."""
    seen = (view.window.weight > 0).sum()
    return float(np.sqrt(cost.sum() / seen) * unit / common.load_protocol().PX_PER_M * 1e3)


def measure_joint_iterations(view: View, model: BasePoses, steps: int) -> Array:
    """Return the 2D error of the joint solver by iteration limit, (steps + 1,) mm."""
    config = common.make_config(tolerance=0.0)
    start, unit = choose_initial_values(view.window, model, config.start_window)
    problem, cameras = _make_camera_step(view, model, start, unit, np.zeros(view.frames - 1))
    limits = [replace(config, max_iterations=n) for n in range(1, steps + 1)]
    found = [common.solve_jointly([view], model, c)[0] for c in limits]
    first = _to_rms_mm(problem.data_cost(cameras), view, unit)
    return np.array([first] + [common.compute_residual_mm(view, r) for r in found])


def measure_periodic_iterations(view: View, model: BasePoses, steps: int) -> Array:
    """Return the 2D error of the periodic solver, started from the non-periodic solution, (steps,) mm."""
    (initial,) = common.solve_jointly([view], model)
    config = common.make_config(tolerance=0.0)
    window = replace(view.window, start=InitialValues(initial.theta, initial.cameras))
    limits = [replace(config, max_iterations=n) for n in range(1, steps + 1)]
    return np.array([common.compute_residual_mm(view, periodic.solve([window], model, c)[0]) for c in limits])


def measure_noisy_starts(report: Report, quick: bool) -> dict[str, Any]:
    """Noisy initial values (figure 13)."""
    levels = (0.0, 0.1) if quick else (0.0, 0.05, 0.1, 0.2, 0.3)
    cases = ((ALGORITHM_1, ALGORITHM_1.configure(tolerance=1e-3, max_iterations=40)), (JOINT, SolverConfig()))
    errors: dict[str, dict[float, list[float]]] = {m.name: {x: [] for x in levels} for m, _ in cases}
    for trial, category in common.show_progress(list_sequences(quick), 'noisy starts'):
        (view,) = common.make_views(trial, [HEADING])
        for method, config in cases:
            model = method.train(category, trial)
            for level in levels:
                window = add_noise_to_start(view.window, model.truncate(config.components), level, config)
                (scores,) = common.compute_all_errors([view], [solve_window(window, model, config)])
                errors[method.name][level].append(scores['mpjpe_mm'])
    rows = [
        [name, *(f'{np.mean(v):.1f} ± {np.std(v):.1f}' for v in by_level.values())]
        for name, by_level in errors.items()
    ]
    report.table(['noise of the initial poses', *(f'{x:.1%}' for x in levels)], rows)
    figure, axes = make_panels(1, width=4.4)
    for method, _ in cases:
        mean, std = (([f(v) for v in errors[method.name].values()]) for f in (np.mean, np.std))
        style = {'fmt': 'o-', 'capsize': 2, 'color': method.colour, 'label': method.name}
        axes[0].errorbar(100 * np.array(levels), mean, std, **style)
    label_axes(axes[0], 'noise of the initial poses, % of stature', 'MPJPE, mm')
    axes[0].set_ylim(bottom=0)
    axes[0].legend()
    report.paper_figure('fig13_noisy_starts', figure, '3D error against noise of the initial values')
    return {n: {f'{x:g}': v for x, v in by.items()} for n, by in errors.items()}


def add_noise_to_start(window: Window, model: BasePoses, level: float, config: SolverConfig) -> Window:
    """Return the window with initial values of the mean pose with noise, a share `level` of the body height."""
    rng = np.random.default_rng(1)
    noise = level * model.stature * rng.standard_normal((len(window.times), *model.mean.shape))
    theta = model.weights(model.mean + noise)
    cameras = fit_cameras_closed_form(
        model.poses(theta), window.points, window.weight, window.times, config.start_window
    )
    return replace(window, start=InitialValues(theta, cameras))


def solve_window(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    """Solve a window by the method of the configuration."""
    if config.method == 'alternation':
        return alternation.reconstruct(window, model, config)
    return joint.solve([window], model, config)[0]


def measure_initial_cameras(report: Report, quick: bool) -> dict[str, Any]:
    """One, two and nine initial cameras, for people seen from behind."""
    counts, trials = (1, 2, 9), {'35_02': 'walk', '09_01': 'run'}
    rows = []
    for trial in list(trials)[: 1 if quick else 2]:
        (view,) = tests = common.make_views(trial, [BEHIND])
        for motions in (trials[trial], ''):
            model = common.train_base_poses(motions, without_subjects=(trial[:2],))
            found = [solve_from_ring([view.window], model, SolverConfig(), count) for count in counts]
            errors = [common.mean_error(common.compute_all_errors(tests, f)) for f in found]
            rows.append([trial.replace('_', '/'), motions or 'all motions', *(f'{e:.1f}' for e in errors)])
    report.table(['trial', 'base poses', *(f'{c} cameras' if c > 1 else '1 camera' for c in counts)], rows)
    return {'rows': rows}


def solve_with_all(tests: Sequence[View], trial: str) -> dict[str, Sequence[Reconstruction]]:
    """Solve the views of a walk with the paper's two models and the project's."""
    return {n: method.solve(tests, 'walk', trial, **values) for n, (method, values) in SOLVERS.items()}


def measure_disturbance(
    report: Report, quick: bool, option: str, levels: Sequence[float], what: str, name: str
) -> dict[str, Any]:
    """Measure the error of all solvers on 35/01 against the strength of a disturbance."""
    mean: dict[str, list[float]] = {s: [] for s in SOLVERS}
    most: dict[str, list[float]] = {s: [] for s in SOLVERS}
    for level in levels:
        tests = common.make_views('35_01', choose_few_headings(quick), **{option: level})
        for solver, found in solve_with_all(tests, '35_01').items():
            errors = [common.compute_frame_errors(v, r) for v, r in zip(tests, found, strict=True)]
            mean[solver].append(float(np.mean([e.mean() for e in errors])))
            most[solver].append(float(np.mean([e.max() for e in errors])))
    rows = [
        [f'{level:.0%}', *(f'{mean[s][i]:.1f} / {most[s][i]:.1f}' for s in SOLVERS)]
        for i, level in enumerate(levels)
    ]
    report.table([what, *(f'{s}: mean / maximum' for s in SOLVERS)], rows)
    figure, axes = make_panels(2)
    for ax, values, title in zip(axes, (mean, most), ('mean over frames', 'maximum over frames'), strict=True):
        draw_curves(ax, 100 * np.array(levels), values, [m.colour for m, _ in SOLVERS.values()])
        label_axes(ax, f'{what}, %', 'MPJPE of a frame, mm', title)
        ax.set_ylim(bottom=0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    report.paper_figure(name, figure, f'3D error against {what}')
    return {'levels': list(levels), 'mean': mean, 'maximum': most}


def measure_missing_points(report: Report, quick: bool) -> dict[str, Any]:
    """Randomly missing points (figure 16)."""
    levels = (0.0, 0.2) if quick else (0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.15, 0.2)
    return measure_disturbance(report, quick, 'missing', levels, 'missing points', 'fig16_missing')


def measure_noise(report: Report, quick: bool) -> dict[str, Any]:
    """Noise (figure 17)."""
    levels = (0.0, 0.2) if quick else (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2)
    return measure_disturbance(report, quick, 'noise', levels, 'noise', 'fig17_noise')


def measure_hidden_limbs(report: Report, _quick: bool) -> dict[str, Any]:
    """Hidden limbs (figures 14 and 15)."""
    (whole,) = common.make_views('07_02', [90])
    cases = {
        'legs behind a box, 0.8 to 1.8 s': (LEGS, slice(24, 54)),
        'far arm hidden throughout': (ARM, slice(None)),
    }
    rows, shown = [], {}
    for name, (joints, frames) in cases.items():
        view = whole.hide_joints(joints, frames)
        found = solve_with_all([view], '07_02')
        for solver, (result,) in found.items():
            estimate, truth = common.align_scale(result.joints, view.true_poses)
            error = np.linalg.norm(estimate - truth, axis=-1) * 1e3
            hidden = error[frames][:, [CMU15.index(j) for j in joints]]
            rows.append([name, solver, f'{hidden.mean():.1f}', f'{error.mean():.1f}'])
        shown[name] = view, found['np, joint'][0]
    report.table(['hidden limbs', 'solver', 'hidden joints: MPJPE, mm', 'all joints: MPJPE, mm'], rows)
    figure = _draw_hidden_limbs(shown)
    report.paper_figure('fig14_15_hidden', figure, 'Hidden limbs: reconstruction and truth from the side')
    return {'rows': rows}


def _draw_hidden_limbs(cases: Mapping[str, tuple[View, Reconstruction]]) -> Any:
    instants = (29, 34, 39, 44)
    figure, axes = make_panels(len(instants) * len(cases), rows=3, height=6.2, width=8.2)
    layout: Any = figure.get_layout_engine()
    layout.set(rect=(0.03, 0, 0.97, 0.95), wspace=0, hspace=0, w_pad=0, h_pad=0)
    for case, (name, (view, result)) in enumerate(cases.items()):
        order = [list(view.sequence['joints3d_names']).index(j) for j in CMU15.joints]
        truth, found = centre_poses(view.true_poses), centre_poses(result.joints)
        image = view.sequence['keypoints'][:, order, :2] - view.sequence['image_size'] / 2
        for column, frame in enumerate(instants, start=case * len(instants)):
            draw_bones(axes[0, column], image[frame] / common.load_protocol().PX_PER_M, CMU15, linewidth=1.4)
            for row, seen_from in enumerate((lambda p: p[..., :2], project_from_side), start=1):
                draw_bones(axes[row, column], seen_from(truth[frame]), CMU15, colour=TRUTH, linewidth=3.5)
                draw_bones(axes[row, column], seen_from(found[frame]), CMU15, linewidth=1.2)
            axes[0, column].text(0, -1.0, f'{frame / common.FPS:.1f} s', fontsize=8, ha='center')
        head = axes[0, case * len(instants)].text(-0.4, -1.25, name, fontsize=9)
        head.set_in_layout(False)
    for ax in axes.ravel():
        ax.set_aspect('equal')
        ax.axis('off')
        ax.set_xlim(-0.45, 0.45)
        ax.set_ylim(0.95, -0.95)
    for row, text in enumerate(('input', '3D from the camera', '3D from the side')):
        side = axes[row, 0].text(-0.5, 0, text, rotation=90, ha='right', va='center', fontsize=8)
        side.set_in_layout(False)
    return figure


def measure_weights_under_noise(report: Report, _quick: bool) -> dict[str, Any]:
    """Weights of the base poses under noise (figure 18)."""
    trial, frames = '07_01', 50
    tests = common.make_views(trial, [HEADING], frames=frames, noise=0.2)
    clean = common.make_views(trial, [HEADING], frames=frames)
    found = {
        'non-periodic, Algorithm 1': ALGORITHM_1.solve(tests, 'walk', trial),
        'non-periodic, joint': JOINT.solve(tests, 'walk', trial),
        'periodic, project': PERIODIC.solve(tests, 'walk', trial),
    }
    printed = {'non-periodic, Algorithm 1': '1.09', 'periodic, project': '1.02'}
    rows = []
    for name, results in found.items():
        (errors,) = common.compute_all_errors(clean, results)
        rows.append([name, printed.get(name), f'{errors["e_paper_cm"]:.2f}', f'{errors["mpjpe_mm"]:.1f}'])
    report.table(['reconstruction', 'paper: e, cm', 'e, cm', 'MPJPE, mm'], rows)
    weights = {
        'ground truth': common.find_true_weights(JOINT.train('walk', trial), trial, frames)[1],
        'non-periodic': found['non-periodic, joint'][0].theta,
        'periodic': found['periodic, project'][0].theta,
    }
    figure, axes = make_panels(3, sharey=True)
    draw_weights(axes, tests[0].sequence['timestamps'], weights)
    report.paper_figure('fig18_weights', figure, 'Weights of the first four base poses')
    return {'rows': rows}
