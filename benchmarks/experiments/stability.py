"""Convergence, noisy initial values, occlusion and image noise (figures 12 to 18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from common import View, make_paper_config
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from experiments.accuracy import choose_few_headings, solve_with_paper_sines, train_both, train_like_paper
from experiments.report import JUMP, NEUTRAL, PERIODIC, RUN, TRUTH, WALK, Section, label_axes, make_panels
from experiments.variants.heading_ring import solve_from_ring
from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation
from mocap_ros.geometry.weak_perspective import (
    CameraStepObjective,
    WeakPerspectiveCameras,
    fit_cameras_closed_form,
    run_camera_step,
    subtract_weighted_centroid,
)
from mocap_ros.models.base_poses import BasePoses
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


def list_sequences(quick: bool) -> list[tuple[str, str]]:
    """List the walks, runs and jumps of the paper's five subjects as (trial, category)."""
    found = [
        (t.name, t.category) for t in common.list_trials() if t.subject in SUBJECTS and t.category in CATEGORIES
    ]
    return found[::36] if quick else found


def measure_convergence(quick: bool) -> Section:
    """Measure the 2D error by iteration (figure 12)."""
    section = Section('Convergence (figure 12)')
    steps = 4 if quick else 10
    curves: dict[str, list[Array]] = {'Algorithm 1': [], 'joint': [], 'periodic': []}
    chosen = list_sequences(quick)
    for index, (trial, category) in enumerate(common.show_progress(chosen, 'convergence')):
        (view,) = common.make_views(trial, [HEADING])
        paper, ours = train_both(category, trial)
        curves['Algorithm 1'].append(measure_half_steps(view, paper, make_paper_config(), steps))
        if index % 2 == 0:
            curves['joint'].append(measure_joint_iterations(view, ours, steps))
        if index % 4 == 0 and category != 'jump':
            curves['periodic'].append(measure_periodic_iterations(view, ours, steps))
    rows = []
    for name, values in curves.items():
        stacked = np.array(values)
        mean, spread = stacked.mean(axis=0), stacked.std(axis=0)
        section.data[name] = {'mean': mean, 'std': spread}
        shown = range(0, stacked.shape[1], 2 if name == 'Algorithm 1' else 1)
        before = ['-'] if name == 'periodic' else []
        rows.append([name, *before, *(f'{mean[i]:.1f} ± {spread[i]:.1f}' for i in shown)])
    section.table(['iterations', *map(str, range(steps + 1))], rows)
    steps_taken = np.diff(np.array(curves['Algorithm 1']), axis=1)
    section.text(
        f"""The 2D error of Algorithm 1 rose in {(steps_taken > 1e-3).sum()} of {steps_taken.size} half steps, by
        at most {max(steps_taken.max(), 0):.2f} mm. The paper reports no rise."""
    )
    figure, axes = make_panels(3, sharey=True)
    for ax, (name, colour) in zip(axes, zip(curves, (WALK, RUN, PERIODIC), strict=True), strict=True):
        stacked = np.array(curves[name])
        x = np.arange(stacked.shape[1]) + (name == 'periodic')
        mean, spread = stacked.mean(axis=0), stacked.std(axis=0)
        ax.fill_between(x, mean - spread, mean + spread, color=colour, alpha=0.2, linewidth=0)
        ax.plot(x, mean, 'o-', color=colour)
        unit = 'half steps' if name == 'Algorithm 1' else 'iterations'
        label_axes(ax, unit, '2D error, mm' if ax is axes[0] else '', name)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes[0].set_ylim(bottom=0)
    section.figure('fig12_convergence', figure, '2D error by iteration, mean and standard deviation')
    return section


def measure_half_steps(view: View, model: BasePoses, config: SolverConfig, steps: int) -> Array:
    """Return the 2D error of Algorithm 1 at the start and after every half step, (2 steps + 1,) mm."""
    model = model.truncate(config.components)
    start, unit = choose_initial_values(view.window, model, config.start_window)
    one = replace(config, max_iterations=1, tolerance=0.0)
    flip = config.flip_weight / np.diff(view.window.times)
    errors: list[float] = []
    for _ in range(steps):
        cameras = start.cameras
        scaled = WeakPerspectiveCameras(cameras.scale / unit, cameras.rotation)
        image, _ = subtract_weighted_centroid(view.window.points / unit, view.window.weight)
        body, _ = subtract_weighted_centroid(model.poses(start.theta), view.window.weight)
        problem = CameraStepObjective(body, image, view.window.weight, flip)
        if not errors:
            errors.append(_to_rms_mm(problem.data_cost(scaled), view, unit))
        errors.append(_to_rms_mm(problem.data_cost(run_camera_step(problem, scaled)), view, unit))
        result = alternation.reconstruct(replace(view.window, start=start, unit=unit), model, one)
        start = InitialValues(result.theta, result.cameras)
        errors.append(common.compute_residual_mm(view, result))
    return np.array(errors)


def _to_rms_mm(cost: Array, view: View, unit: float) -> float:
    """Convert squared errors in m at the initial scale to the root mean square in mm at the true scale."""
    seen = (view.window.weight > 0).sum()
    return float(np.sqrt(cost.sum() / seen) * unit / common.load_protocol().PX_PER_M * 1e3)


def measure_joint_iterations(view: View, model: BasePoses, steps: int) -> Array:
    """Return the 2D error of the joint solver by iteration limit, (steps + 1,) mm."""
    config = common.make_config(tolerance=0.0)
    start, unit = choose_initial_values(view.window, model, config.start_window)
    scaled = WeakPerspectiveCameras(start.cameras.scale / unit, start.cameras.rotation)
    image, _ = subtract_weighted_centroid(view.window.points / unit, view.window.weight)
    body, _ = subtract_weighted_centroid(model.poses(start.theta), view.window.weight)
    at_start = CameraStepObjective(body, image, view.window.weight, np.zeros(view.frames - 1))
    found = [
        common.solve_jointly([view], model, replace(config, max_iterations=n))[0] for n in range(1, steps + 1)
    ]
    first = _to_rms_mm(at_start.data_cost(scaled), view, unit)
    return np.array([first] + [common.compute_residual_mm(view, r) for r in found])


def measure_periodic_iterations(view: View, model: BasePoses, steps: int) -> Array:
    """Return the 2D error of the periodic solver, started from the non-periodic solution, (steps,) mm."""
    (initial,) = common.solve_jointly([view], model)
    config = common.make_config(tolerance=0.0)
    window = replace(view.window, start=InitialValues(initial.theta, initial.cameras))
    limits = [replace(config, max_iterations=n) for n in range(1, steps + 1)]
    return np.array([common.compute_residual_mm(view, periodic.solve([window], model, c)[0]) for c in limits])


def measure_noisy_starts(quick: bool) -> Section:
    """Measure the error against noise of the initial values (figure 13)."""
    section = Section('Noisy initial values (figure 13)')
    levels = (0.0, 0.1) if quick else (0.0, 0.05, 0.1, 0.2, 0.3)
    chosen = list_sequences(quick)
    errors: dict[str, dict[float, list[float]]] = {'Algorithm 1': {}, 'joint': {}}
    for trial, category in common.show_progress(chosen, 'noisy starts'):
        (view,) = common.make_views(trial, [HEADING])
        paper, ours = train_both(category, trial)
        for level in levels:
            slow, fast = make_paper_config(tolerance=1e-3, max_iterations=40), SolverConfig()
            for name, model, config in (('Algorithm 1', paper, slow), ('joint', ours, fast)):
                started = View(view.sequence, view.heading)
                window = add_noise_to_start(started.window, model.truncate(config.components), level, config)
                result = solve_window(window, model, config)
                error = common.compute_errors(view, result.joints, model.skeleton.joints)['mpjpe_mm']
                errors[name].setdefault(level, []).append(error)
    rows = [
        [name, *(f'{np.mean(v):.1f} ± {np.std(v):.1f}' for v in by_level.values())]
        for name, by_level in errors.items()
    ]
    section.table(['noise of the initial poses', *(f'{x:.1%}' for x in levels)], rows)
    section.data = {n: {f'{x:g}': v for x, v in by.items()} for n, by in errors.items()}
    figure, axes = make_panels(1, width=4.4)
    for (name, by_level), colour in zip(errors.items(), (WALK, RUN), strict=True):
        mean = [np.mean(v) for v in by_level.values()]
        axes[0].errorbar(
            100 * np.array(levels), mean, [np.std(v) for v in by_level.values()], fmt='o-', capsize=2,
            color=colour, label=name,
        )  # fmt: skip
    label_axes(axes[0], 'noise of the initial poses, % of stature', 'MPJPE, mm')
    axes[0].set_ylim(bottom=0)
    axes[0].legend()
    section.figure('fig13_noisy_starts', figure, '3D error against noise of the initial values')
    return section


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


def measure_initial_cameras(quick: bool) -> Section:
    """Measure the error from one, two and a ring of initial cameras, for people seen from behind."""
    section = Section('One, two and nine initial cameras')
    counts = (1, 2, 9)
    trials = {'35_02': 'walk'} if quick else {'35_02': 'walk', '09_01': 'run'}
    rows = []
    for trial, category in trials.items():
        (view,) = tests = common.make_views(trial, [BEHIND])
        for motions in (category, ''):
            model = common.train_base_poses(motions, without_subjects=(trial[:2],))
            found = [solve_from_ring([view.window], model, SolverConfig(), count) for count in counts]
            errors = [common.mean_error(common.compute_all_errors(tests, f, model)) for f in found]
            rows.append([trial.replace('_', '/'), motions or 'all motions', *(f'{e:.1f}' for e in errors)])
    section.table(['trial', 'base poses', *(f'{c} cameras' if c > 1 else '1 camera' for c in counts)], rows)
    section.data['rows'] = rows
    return section


# Solvers in the tables; np means non-periodic.
SOLVERS = ('np, Algorithm 1', 'np, joint', "periodic, the paper's sines", 'periodic, project')
# Colour of each solver in the figures.
COLOURS = dict(zip(SOLVERS, (WALK, RUN, JUMP, PERIODIC), strict=True))


def solve_with_all(tests: Sequence[View], trial: str, category: str) -> dict[str, Sequence[Reconstruction]]:
    """Solve the views with the paper's two models and the project's, with the category model without the trial."""
    paper, ours = train_both(category, trial)
    found = (
        common.solve_by_alternation(tests, paper, make_paper_config(tolerance=1e-3)),
        common.solve_jointly(tests, ours),
        solve_with_paper_sines(tests, paper),
        common.solve_periodically(tests, ours),
    )
    return dict(zip(SOLVERS, found, strict=True))


def measure_disturbance(
    section: Section, quick: bool, option: str, levels: Sequence[float], what: str, name: str
) -> None:
    """Measure the error of all solvers on 35/01 against the strength of a disturbance."""
    trial = '35_01'
    mean: dict[str, list[float]] = {s: [] for s in SOLVERS}
    most: dict[str, list[float]] = {s: [] for s in SOLVERS}
    for level in levels:
        tests = common.make_views(trial, choose_few_headings(quick), **{option: level})
        for solver, found in solve_with_all(tests, trial, 'walk').items():
            errors = [common.compute_frame_errors(v, r) for v, r in zip(tests, found, strict=True)]
            mean[solver].append(float(np.mean([e.mean() for e in errors])))
            most[solver].append(float(np.mean([e.max() for e in errors])))
    rows = [
        [f'{level:.0%}', *(f'{mean[s][i]:.1f} / {most[s][i]:.1f}' for s in SOLVERS)]
        for i, level in enumerate(levels)
    ]
    section.table([what, *(f'{s}: mean / maximum' for s in SOLVERS)], rows)
    section.data = {'levels': list(levels), 'mean': mean, 'maximum': most}
    figure, axes = make_panels(2)
    for ax, values, title in zip(axes, (mean, most), ('mean over frames', 'maximum over frames'), strict=True):
        for solver in SOLVERS:
            ax.plot(100 * np.array(levels), values[solver], 'o-', color=COLOURS[solver], label=solver)
        label_axes(ax, f'{what}, %', 'MPJPE of a frame, mm', title)
        ax.set_ylim(bottom=0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    section.figure(name, figure, f'3D error against {what}')


def measure_missing_points(quick: bool) -> Section:
    """Measure the error against the share of randomly missing points (figure 16)."""
    section = Section('Randomly missing points (figure 16)')
    levels = (0.0, 0.2) if quick else (0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.15, 0.2)
    measure_disturbance(section, quick, 'missing', levels, 'missing points', 'fig16_missing')
    return section


def measure_noise(quick: bool) -> Section:
    """Measure the error against image noise (figure 17)."""
    section = Section('Noise (figure 17)')
    levels = (0.0, 0.2) if quick else (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2)
    measure_disturbance(section, quick, 'noise', levels, 'noise', 'fig17_noise')
    return section


def measure_hidden_limbs(quick: bool) -> Section:
    """Measure the error of hidden limbs (figures 14 and 15)."""
    section = Section('Hidden limbs (figures 14 and 15)')
    trial = '07_02'
    (whole,) = common.make_views(trial, [90])
    cases = {
        'legs behind a box, 0.8 to 1.8 s': (whole.hide_joints(LEGS, slice(24, 54)), LEGS, slice(24, 54)),
        'far arm hidden throughout': (whole.hide_joints(ARM), ARM, slice(None)),
    }
    rows = []
    shown: dict[str, Reconstruction] = {}
    for name, (view, joints, frames) in cases.items():
        for solver, found in solve_with_all([view], trial, 'walk').items():
            skeleton = common.train_base_poses('walk', without_trials=(trial,)).skeleton
            columns = [skeleton.index(j) for j in joints]
            estimate, truth = common.align_scale(found[0].joints, view.true_poses)
            error = np.linalg.norm(estimate - truth, axis=-1) * 1e3
            rows.append([name, solver, f'{error[frames][:, columns].mean():.1f}', f'{error.mean():.1f}'])
            if solver == 'np, joint':
                shown[name] = found[0]
    section.table(['hidden limbs', 'solver', 'hidden joints: MPJPE, mm', 'all joints: MPJPE, mm'], rows)
    section.data['rows'] = rows
    if not quick:
        figure = _draw_hidden_limbs(cases, shown)
        section.figure('fig14_15_hidden', figure, 'Hidden limbs: reconstruction and truth from the side')
    return section


def _draw_hidden_limbs(cases: dict[str, Any], shown: dict[str, Reconstruction]) -> Any:
    skeleton = common.train_base_poses('walk').skeleton
    instants = (29, 34, 39, 44)
    figure, axes = make_panels(len(instants) * len(cases), rows=3, height=6.2, width=8.2)
    layout: Any = figure.get_layout_engine()
    layout.set(rect=(0.03, 0, 0.97, 0.95), wspace=0, hspace=0, w_pad=0, h_pad=0)
    for case, (name, (view, _, _)) in enumerate(cases.items()):
        order = [list(view.sequence['joints3d_names']).index(j) for j in skeleton.joints]
        truth, found = centre_poses(view.true_poses), centre_poses(shown[name].joints)
        image = view.sequence['keypoints'][:, order, :2] - view.sequence['image_size'] / 2
        for column, frame in enumerate(instants, start=case * len(instants)):
            draw_bones(axes[0, column], image[frame] / common.load_protocol().PX_PER_M, skeleton, linewidth=1.4)
            for row, seen_from in enumerate((lambda p: p[..., :2], project_from_side), start=1):
                draw_bones(axes[row, column], seen_from(truth[frame]), skeleton, colour=TRUTH, linewidth=3.5)
                draw_bones(axes[row, column], seen_from(found[frame]), skeleton, linewidth=1.2)
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


def measure_weights_under_noise(_quick: bool) -> Section:
    """Measure and draw the weights of the base poses under noise (figure 18)."""
    section = Section('Weights of the base poses under noise (figure 18)')
    trial, frames, level = '07_01', 50, 0.2
    tests = common.make_views(trial, [HEADING], frames=frames, noise=level)
    ours = common.train_base_poses('walk', without_trials=(trial,))
    true = common.make_views(trial, [HEADING], frames=frames)[0]
    body = next(t.poses for t in common.list_trials() if t.name == trial)[:frames]
    poses = centre_poses(body) * (
        np.linalg.norm(ours.mean) / np.linalg.norm(centre_poses(body), axis=(1, 2)).mean()
    )
    aligned = poses @ np.swapaxes(fit_heading_rotation(poses, ours.mean), -1, -2)
    times = tests[0].sequence['timestamps']
    kinds: dict[str, tuple[Array, Reconstruction | None]] = {'ground truth': (ours.weights(aligned), None)}
    (jointly,) = common.solve_jointly(tests, ours)
    (harmonic,) = common.solve_periodically(tests, ours)
    kinds |= {'non-periodic': (jointly.theta, jointly), 'periodic': (harmonic.theta, harmonic)}
    (plainly,) = common.solve_by_alternation(tests, train_like_paper('walk', trial), make_paper_config())
    rows = []
    for name, result, model in (
        ('non-periodic, Algorithm 1', plainly, train_like_paper('walk', trial)),
        ('non-periodic, joint', jointly, ours),
        ('periodic, project', harmonic, ours),
    ):
        errors = common.compute_errors(true, result.joints, model.skeleton.joints)
        printed = {'non-periodic, Algorithm 1': '1.09', 'periodic, project': '1.02'}.get(name)
        rows.append([name, printed, f'{errors["e_paper_cm"]:.2f}', f'{errors["mpjpe_mm"]:.1f}'])
    section.table(['reconstruction', 'paper: e, cm', 'e, cm', 'MPJPE, mm'], rows)
    section.data['rows'] = rows
    figure, axes = make_panels(3, sharey=True)
    for ax, (name, (theta, _)) in zip(axes, kinds.items(), strict=True):
        for k in range(4):
            ax.plot(times, theta[:, k], color=(WALK, RUN, JUMP, NEUTRAL)[k], label=f'base pose {k + 1}')
        label_axes(ax, 'time, s', 'weight, m' if ax is axes[0] else '', name)
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    section.figure('fig18_weights', figure, 'Weights of the first four base poses')
    return section
