"""Convergence, noisy starts, occlusion and noise (figures 12 to 18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from common import View, paper_config
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from experiments.accuracy import few_headings, plain
from experiments.report import JUMP, PERIODIC, PLAIN, RUN, TRUTH, WALK, Section, label, panels
from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import centred, heading_to
from mocap_ros.geometry.weak_perspective import CameraProblem, Cameras, centred_on_seen, closed_form, refine
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import alternation, joint, periodic
from mocap_ros.solvers.window import Reconstruction, Start, Window, begin
from mocap_ros.viewing.plots import draw_bones, from_the_side

Array = NDArray[np.float64]

SUBJECTS = ('07', '09', '13', '16', '35')
CATEGORIES = ('walk', 'run', 'jump')
HEADING = 45
ARM = ('lshoulder', 'lelbow', 'lwrist')
LEGS = ('lknee', 'lankle', 'rknee', 'rankle')


def sequences(quick: bool) -> list[tuple[str, str]]:
    """(trial, category) of the walks, runs and jumps of the paper's five subjects."""
    found = [(t.name, t.category) for t in common.trials() if t.subject in SUBJECTS and t.category in CATEGORIES]
    return found[::36] if quick else found


def convergence(quick: bool) -> Section:
    """Figure 12."""
    section = Section('Convergence (figure 12)')
    steps = 4 if quick else 10
    curves: dict[str, list[Array]] = {'Algorithm 1': [], 'joint': [], 'periodic': []}
    chosen = sequences(quick)
    for index, (trial, category) in enumerate(common.progress(chosen, 'convergence')):
        (view,) = common.views(trial, [HEADING])
        paper, ours = plain(category, trial), common.trained(category, without_trials=(trial,))
        curves['Algorithm 1'].append(half_steps(view, paper, paper_config(), steps))
        if index % 2 == 0:
            curves['joint'].append(joint_iterations(view, ours, steps))
        if index % 4 == 0 and category != 'jump':
            curves['periodic'].append(periodic_iterations(view, ours, steps))
    section.text(
        f"""{len(chosen)} sequences: every walk, run and jump of subjects {', '.join(SUBJECTS)} that the data has
        (the paper: 57), heading {HEADING} degrees, category model without the trial. 2D error: root mean square,
        mm at the body. Algorithm 1 (K = 6) by half steps, cameras first, as in the paper. The joint solver (on
        every other sequence) and the periodic one (on {len(curves['periodic'])} of the walks and runs) by
        iteration limit: their first iterations go into finding the noise; the periodic one starts from the
        non-periodic solution."""
    )
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
        at most {max(steps_taken.max(), 0):.2f} mm. The paper saw no rise."""
    )
    figure, axes = panels(3, sharey=True)
    for ax, (name, colour) in zip(axes, zip(curves, (WALK, RUN, PERIODIC), strict=True), strict=True):
        stacked = np.array(curves[name])
        x = np.arange(stacked.shape[1]) + (name == 'periodic')
        mean, spread = stacked.mean(axis=0), stacked.std(axis=0)
        ax.fill_between(x, mean - spread, mean + spread, color=colour, alpha=0.2, linewidth=0)
        ax.plot(x, mean, 'o-', color=colour)
        unit = 'half steps' if name == 'Algorithm 1' else 'iterations'
        label(ax, unit, '2D error, mm' if ax is axes[0] else '', name)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes[0].set_ylim(bottom=0)
    section.figure('fig12_convergence', figure, '2D error by iteration, mean and standard deviation')
    return section


def half_steps(view: View, model: BasePoses, config: SolverConfig, steps: int) -> Array:
    """(2 steps + 1,) mm, 2D error of Algorithm 1 at the start and after every half step."""
    model = model.truncated(config.components)
    start, unit = begin(view.window, model, config.start_window)
    one = replace(config, max_iterations=1, tolerance=0.0)
    flip = config.flip_weight / np.diff(view.window.times)
    errors: list[float] = []
    for _ in range(steps):
        cameras = start.cameras
        scaled = Cameras(cameras.scale / unit, cameras.rotation)
        image, _ = centred_on_seen(view.window.points / unit, view.window.weight)
        body, _ = centred_on_seen(model.poses(start.theta), view.window.weight)
        problem = CameraProblem(body, image, view.window.weight, flip)
        if not errors:
            errors.append(_rms_mm(problem.data_cost(scaled), view, unit))
        errors.append(_rms_mm(problem.data_cost(refine(problem, scaled)), view, unit))
        result = alternation.reconstruct(replace(view.window, start=start, unit=unit), model, one)
        start = Start(result.theta, result.cameras)
        errors.append(common.residual_mm(view, result))
    return np.array(errors)


def _rms_mm(cost: Array, view: View, unit: float) -> float:
    """Squared errors in metres at the start scale -> root mean square, mm at the true one."""
    seen = (view.window.weight > 0).sum()
    return float(np.sqrt(cost.sum() / seen) * unit / common.protocol().PX_PER_M * 1e3)


def joint_iterations(view: View, model: BasePoses, steps: int) -> Array:
    """(steps + 1,) mm, 2D error of the joint solver by iteration limit."""
    config = common.changed(tolerance=0.0)
    start, unit = begin(view.window, model, config.start_window)
    scaled = Cameras(start.cameras.scale / unit, start.cameras.rotation)
    image, _ = centred_on_seen(view.window.points / unit, view.window.weight)
    body, _ = centred_on_seen(model.poses(start.theta), view.window.weight)
    at_start = CameraProblem(body, image, view.window.weight, np.zeros(view.frames - 1))
    found = [common.solved([view], model, replace(config, max_iterations=n))[0] for n in range(1, steps + 1)]
    first = _rms_mm(at_start.data_cost(scaled), view, unit)
    return np.array([first] + [common.residual_mm(view, r) for r in found])


def periodic_iterations(view: View, model: BasePoses, steps: int) -> Array:
    """(steps,) mm, 2D error of the periodic solver by iteration limit, from the non-periodic solution."""
    (begun,) = common.solved([view], model)
    config = common.changed(tolerance=0.0)
    window = replace(view.window, start=Start(begun.theta, begun.cameras))
    limits = [replace(config, max_iterations=n) for n in range(1, steps + 1)]
    return np.array([common.residual_mm(view, periodic.solve([window], model, c)[0]) for c in limits])


def noisy_starts(quick: bool) -> Section:
    """Figure 13."""
    section = Section('Noisy start values (figure 13)')
    levels = (0.0, 0.1) if quick else (0.0, 0.05, 0.1, 0.2, 0.3)
    chosen = sequences(quick)
    errors: dict[str, dict[float, list[float]]] = {'Algorithm 1': {}, 'joint': {}}
    for trial, category in common.progress(chosen, 'noisy starts'):
        (view,) = common.views(trial, [HEADING])
        paper, ours = plain(category, trial), common.trained(category, without_trials=(trial,))
        for level in levels:
            slow, fast = paper_config(tolerance=1e-3, max_iterations=40), SolverConfig()
            for name, model, config in (('Algorithm 1', paper, slow), ('joint', ours, fast)):
                started = View(view.sequence, view.heading)
                window = noisy_start(started.window, model.truncated(config.components), level, config)
                result = solve_window(window, model, config)
                error = common.score(view, result.joints, model.skeleton.joints)['mpjpe_mm']
                errors[name].setdefault(level, []).append(error)
    section.text(
        f"""The {len(chosen)} sequences of figure 12. The start is the mean pose with Gaussian noise on every
        joint of every frame, its standard deviation a share of the stature, as far as the base poses can express
        it (K = 6 for Algorithm 1, K = {SolverConfig().components} for the joint solver), and the cameras that
        fit these poses. MPJPE, mm, mean and standard deviation over the sequences. The paper: plausible up to 10
        %, degenerate above."""
    )
    rows = [
        [name, *(f'{np.mean(v):.1f} ± {np.std(v):.1f}' for v in by_level.values())]
        for name, by_level in errors.items()
    ]
    section.table(['noise of the start', *(f'{x:.1%}' for x in levels)], rows)
    section.data = {n: {f'{x:g}': v for x, v in by.items()} for n, by in errors.items()}
    figure, axes = panels(1, width=4.4)
    for (name, by_level), colour in zip(errors.items(), (WALK, RUN), strict=True):
        mean = [np.mean(v) for v in by_level.values()]
        axes[0].errorbar(
            100 * np.array(levels), mean, [np.std(v) for v in by_level.values()], fmt='o-', capsize=2,
            color=colour, label=name,
        )  # fmt: skip
    label(axes[0], 'noise of the start, % of stature', 'MPJPE, mm')
    axes[0].set_ylim(bottom=0)
    axes[0].legend()
    section.figure('fig13_noisy_starts', figure, '3D error against noise of the start values')
    return section


def noisy_start(window: Window, model: BasePoses, level: float, config: SolverConfig) -> Window:
    rng = np.random.default_rng(1)
    noise = level * model.stature * rng.standard_normal((len(window.times), *model.mean.shape))
    theta = model.weights(model.mean + noise)
    cameras = closed_form(model.poses(theta), window.points, window.weight, window.times, config.start_window)
    return replace(window, start=Start(theta, cameras))


def solve_window(window: Window, model: BasePoses, config: SolverConfig) -> Reconstruction:
    if config.method == 'alternation':
        return alternation.reconstruct(window, model, config)
    return joint.solve([window], model, config)[0]


SOLVERS = ('np, Algorithm 1', 'np, joint', "periodic, the paper's sines", 'periodic, project')
COLOURS = dict(zip(SOLVERS, (WALK, RUN, JUMP, PERIODIC), strict=True))


def all_solvers(tests: Sequence[View], trial: str, category: str) -> dict[str, Sequence[Reconstruction]]:
    """The paper's two models and the project's, category model without the trial."""
    paper, ours = plain(category, trial), common.trained(category, without_trials=(trial,))
    found = (
        common.alternate(tests, paper, paper_config(tolerance=1e-3)),
        common.solved(tests, ours),
        common.periodically(tests, paper, paper_config(components=4, paper_sines=True)),
        common.periodically(tests, ours),
    )
    return dict(zip(SOLVERS, found, strict=True))


def disturbed(section: Section, quick: bool, option: str, levels: Sequence[float], what: str, name: str) -> None:
    """Error of all solvers on 35/01 against the strength of a disturbance."""
    trial = '35_01'
    mean: dict[str, list[float]] = {s: [] for s in SOLVERS}
    most: dict[str, list[float]] = {s: [] for s in SOLVERS}
    for level in levels:
        tests = common.views(trial, few_headings(quick), **{option: level})
        for solver, found in all_solvers(tests, trial, 'walk').items():
            errors = [common.frame_errors(v, r) for v, r in zip(tests, found, strict=True)]
            mean[solver].append(float(np.mean([e.mean() for e in errors])))
            most[solver].append(float(np.mean([e.max() for e in errors])))
    rows = [
        [f'{level:.0%}', *(f'{mean[s][i]:.1f} / {most[s][i]:.1f}' for s in SOLVERS)]
        for i, level in enumerate(levels)
    ]
    section.table([what, *(f'{s}: mean / maximum' for s in SOLVERS)], rows)
    section.data = {'levels': list(levels), 'mean': mean, 'maximum': most}
    figure, axes = panels(2)
    for ax, values, title in zip(axes, (mean, most), ('mean over frames', 'maximum over frames'), strict=True):
        for solver in SOLVERS:
            ax.plot(100 * np.array(levels), values[solver], 'o-', color=COLOURS[solver], label=solver)
        label(ax, f'{what}, %', 'MPJPE of a frame, mm', title)
        ax.set_ylim(bottom=0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    section.figure(name, figure, f'3D error against {what}')


def occlusion(quick: bool) -> Section:
    """Figure 16."""
    section = Section('Randomly missing points (figure 16)')
    levels = (0.0, 0.2) if quick else (0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.15, 0.2)
    section.text(
        f"""Walk 35/01, headings {', '.join(map(str, few_headings(quick)))}, category model without the trial;
        error in mm, mean and maximum over the frames, mean over the headings. The paper's non-periodic
        reconstruction has a high maximal error above 3 % missing, its periodic one is stable to 20 %."""
    )
    disturbed(section, quick, 'missing', levels, 'missing points', 'fig16_missing')
    return section


def noise(quick: bool) -> Section:
    """Figure 17."""
    section = Section('Noise (figure 17)')
    levels = (0.0, 0.2) if quick else (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2)
    section.text(
        """As before; Gaussian noise, its standard deviation a share of the largest range of motion of any 2D
        point, as in the paper, whose periodic error stays nearly constant while the non-periodic one rises."""
    )
    disturbed(section, quick, 'noise', levels, 'noise', 'fig17_noise')
    return section


def hidden(quick: bool) -> Section:
    """Figures 14 and 15."""
    section = Section('Limbs hidden (figures 14 and 15)')
    trial = '07_02'
    (whole,) = common.views(trial, [90])
    cases = {
        'legs behind a box, 0.8 to 1.8 s': (whole.hiding(LEGS, slice(24, 54)), LEGS, slice(24, 54)),
        'far arm hidden throughout': (whole.hiding(ARM), ARM, slice(None)),
    }
    section.text(
        """Walk 07/02 from the side (heading 90), category model without the trial. Figure 14: knees and ankles
        not seen for a second; figure 15: shoulder, elbow and wrist of the arm away from the camera never seen
        (20 % of the points). MPJPE in mm of the hidden joints while hidden, and of all. The picture shows the
        joint solver: blue left, red right, grey truth."""
    )
    rows = []
    shown: dict[str, Reconstruction] = {}
    for name, (view, joints, frames) in cases.items():
        for solver, found in all_solvers([view], trial, 'walk').items():
            skeleton = common.trained('walk', without_trials=(trial,)).skeleton
            columns = [skeleton.index(j) for j in joints]
            order = [list(view.sequence['joints3d_names']).index(j) for j in skeleton.joints]
            truth = centred(view.truth[:, order])
            result = found[0]
            estimate = centred(result.joints)
            estimate = estimate * ((estimate * truth).sum() / (estimate**2).sum())
            error = np.linalg.norm(estimate - truth, axis=-1) * 1e3
            rows.append([name, solver, f'{error[frames][:, columns].mean():.1f}', f'{error.mean():.1f}'])
            if solver == 'np, joint':
                shown[name] = result
    section.table(['hidden', 'solver', 'hidden joints, mm', 'all joints, mm'], rows)
    section.data['rows'] = rows
    if not quick:
        figure = _hidden_figure(cases, shown)
        section.figure('fig14_15_hidden', figure, 'Hidden limbs: reconstruction and truth from the side')
    return section


def _hidden_figure(cases: dict[str, Any], shown: dict[str, Reconstruction]) -> Any:
    skeleton = common.trained('walk').skeleton
    instants = (29, 34, 39, 44)
    figure, axes = panels(len(instants) * len(cases), rows=3, height=6.2, width=8.2)
    figure.get_layout_engine().set(rect=(0.03, 0, 0.97, 0.95), wspace=0, hspace=0, w_pad=0, h_pad=0)
    for case, (name, (view, _, _)) in enumerate(cases.items()):
        order = [list(view.sequence['joints3d_names']).index(j) for j in skeleton.joints]
        truth, found = centred(view.truth[:, order]), centred(shown[name].joints)
        image = view.sequence['keypoints'][:, order, :2] - view.sequence['image_size'] / 2
        for column, frame in enumerate(instants, start=case * len(instants)):
            draw_bones(axes[0, column], image[frame] / common.protocol().PX_PER_M, skeleton, linewidth=1.4)
            for row, seen_from in enumerate((lambda p: p[..., :2], from_the_side), start=1):
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


def weights_under_noise(_quick: bool) -> Section:
    """Figure 18."""
    section = Section('Weights of the base poses under noise (figure 18)')
    trial, frames, level = '07_01', 50, 0.2
    tests = common.views(trial, [HEADING], frames=frames, noise=level)
    ours = common.trained('walk', without_trials=(trial,))
    true = common.views(trial, [HEADING], frames=frames)[0]
    body = next(t.poses for t in common.trials() if t.name == trial)[:frames]
    poses = centred(body) * (np.linalg.norm(ours.mean) / np.linalg.norm(centred(body), axis=(1, 2)).mean())
    aligned = poses @ np.swapaxes(heading_to(poses, ours.mean), -1, -2)
    times = tests[0].sequence['timestamps']
    kinds: dict[str, tuple[Array, Reconstruction | None]] = {'ground truth': (ours.weights(aligned), None)}
    (jointly,) = common.solved(tests, ours)
    (harmonic,) = common.periodically(tests, ours)
    kinds |= {'non-periodic': (jointly.theta, jointly), 'periodic': (harmonic.theta, harmonic)}
    (plainly,) = common.alternate(tests, plain('walk', trial), paper_config())
    rows = []
    for name, result, model in (
        ('non-periodic, Algorithm 1', plainly, plain('walk', trial)),
        ('non-periodic, joint', jointly, ours),
        ('periodic, project', harmonic, ours),
    ):
        errors = common.score(true, result.joints, model.skeleton.joints)
        printed = {'non-periodic, Algorithm 1': '1.09', 'periodic, project': '1.02'}.get(name)
        rows.append([name, printed, f'{errors["e_paper_cm"]:.2f}', f'{errors["mpjpe_mm"]:.1f}'])
    section.text(
        f"""Walk 07/01, the first {frames} frames at 30 fps (the paper's 200 at 120 Hz), {level:.0%} noise,
        heading {HEADING}, walk model without the trial; e in cm, where the paper's f is four times ours, so that
        its figures would be twice as large at our rate."""
    )
    section.table(['reconstruction', 'paper: e, cm', 'e, cm', 'MPJPE, mm'], rows)
    section.data['rows'] = rows
    figure, axes = panels(3, sharey=True)
    for ax, (name, (theta, _)) in zip(axes, kinds.items(), strict=True):
        for k in range(4):
            ax.plot(times, theta[:, k], color=(WALK, RUN, JUMP, PLAIN)[k], label=f'base pose {k + 1}')
        label(ax, 'time, s', 'weight, m' if ax is axes[0] else '', name)
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    section.figure('fig18_weights', figure, 'Weights of the first four base poses')
    return section
