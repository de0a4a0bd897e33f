"""Table 1, and the error against the number of base poses and the bone regulariser (figures 6 to 11)."""

from __future__ import annotations

from collections.abc import Sequence

import common
import numpy as np
from common import View, make_paper_config

from experiments.report import CATEGORY_COLOURS, NEUTRAL, RUN, WALK, Section, label_axes, make_panels
from experiments.variants.frobenius import reconstruct_with_printed_norms
from experiments.variants.relative_bones import solve_with_relative_bones
from experiments.variants.sines import solve_with_sines
from mocap_ros.config import SolverConfig
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import alternation
from mocap_ros.solvers.window import Reconstruction

# Trial of each category in table 1.
TABLE_1_TRIALS = {'walk': '35_02', 'run': '35_17', 'jump': '13_11'}
# cm, the values of e that the paper prints, by row and category.
PAPER_ERRORS_CM: dict[str, dict[str, float | None]] = {
    'periodic': {'walk': 0.784, 'run': 0.968, 'jump': None},
    'np (beta = 0)': {'walk': 0.295, 'run': 0.661, 'jump': 1.226},
    'best': {'walk': 0.183, 'run': 0.523, 'jump': 1.090},
    'np all': {'walk': 0.334, 'run': 2.805, 'jump': 1.313},
}
CAPTURE_RATE_HZ = 120.0  # Hz, rate at which the trials were captured
# Weights of the bone regulariser among which the row `best` chooses.
BETAS = (0.0, 0.1, 0.3, 1.0, 3.0)

Cell = tuple[list[dict[str, float]], str]  # errors by view, and the setting
Curves = dict[str, dict[str, list[tuple[float, float]]]]  # mm, 3D and 2D errors by solver and trial


def choose_headings(quick: bool) -> tuple[int, ...]:
    return common.HEADINGS_DEG[1:2] if quick else common.HEADINGS_DEG


def choose_few_headings(quick: bool) -> tuple[int, ...]:
    return (45,) if quick else (0, 45, 90, 135)


def train_like_paper(category: str, trial: str, *, own: bool = False) -> BasePoses:
    """Train base poses on the poses alone as the paper does, without the trial, and with the heading aligned."""
    only = (trial[:2],) if own else ()
    return common.train_base_poses(category, without_trials=(trial,), only_subjects=only, plain=True)


def train_both(category: str, trial: str) -> tuple[BasePoses, BasePoses]:
    """Train base poses as the paper does and as this project does, both without the trial."""
    return train_like_paper(category, trial), common.train_base_poses(category, without_trials=(trial,))


def solve_with_paper_sines(
    tests: Sequence[View], model: BasePoses, components: int = 4, bone_weight: float = 1.0
) -> Sequence[Reconstruction]:
    """Solve the views with the paper's periodic model, one sine for each base pose."""
    config = make_paper_config(components=components, bone_weight=bone_weight)
    return solve_with_sines([v.window for v in tests], model, config)


def find_best_regulariser(tests: Sequence[View], model: BasePoses, settings: dict[float, SolverConfig]) -> Cell:
    """Return the errors with the regulariser whose mean error is smallest, as in the row `best`, and its name."""
    found = {}
    for beta, config in settings.items():
        solve = common.solve_by_alternation if config.method == 'alternation' else common.solve_jointly
        found[beta] = common.compute_all_errors(tests, solve(tests, model, config), model)
    best = min(found, key=lambda beta: common.mean_error(found[beta], 'e_paper_cm'))
    return found[best], f'beta {best:g}'


def measure_table_1(quick: bool) -> Section:
    """Measure table 1 of the paper."""
    section = Section('Table 1: walk, run, jump')
    betas = BETAS[3:4] if quick else BETAS
    defaults = SolverConfig()
    own_beta = {defaults.bone_weight: defaults}
    by_beta = {b: make_paper_config(bone_weight=b, tolerance=2e-4) for b in betas}
    many = {b: make_paper_config(bone_weight=b, components=15, tolerance=2e-4) for b in betas}
    cells: dict[str, dict[str, dict[str, Cell]]] = {}
    for category, trial in list(TABLE_1_TRIALS.items())[: 2 if quick else 3]:
        tests = common.make_views(trial, choose_headings(quick))
        everything = common.train_base_poses(without_trials=(trial,))
        for training, own in (('category', False),) if quick else (('own', True), ('category', False)):
            only = (trial[:2],) if own else ()
            paper = train_like_paper(category, trial, own=own)
            ours = common.train_base_poses(category, without_trials=(trial,), only_subjects=only)
            rows: dict[str, dict[str, Cell]] = {}
            if category != 'jump':
                sines = common.compute_all_errors(tests, solve_with_paper_sines(tests, paper), paper)
                periodic = common.compute_all_errors(tests, common.solve_periodically(tests, ours), ours)
                rows['periodic'] = {'paper': (sines, 'K = 4'), 'joint': (periodic, f'H = {defaults.harmonics}')}
            rows['np (beta = 0)'] = {
                'paper': find_best_regulariser(tests, paper, {0.0: make_paper_config(bone_weight=0.0)}),
                'joint': find_best_regulariser(tests, ours, {0.0: common.make_config(bone_weight=0.0)}),
            }
            grid = {b: common.make_config(bone_weight=b) for b in (*betas, defaults.bone_weight)}
            rows['best'] = {
                'paper': find_best_regulariser(tests, paper, by_beta),
                'joint': find_best_regulariser(tests, ours, grid),
            }
            rows['joint solver, defaults'] = {'joint': find_best_regulariser(tests, ours, own_beta)}
            if not own:
                rows['np all'] = {
                    'paper': find_best_regulariser(tests, everything, many),
                    'joint': find_best_regulariser(tests, everything, own_beta),
                }
            cells[f'{category} {training}'] = rows
    _show_table_1(section, cells)
    keys = ('e_paper_cm', 'mpjpe_mm', 'pa_mpjpe_mm')
    section.data['cells'] = {
        key: {
            row: {who: {k: common.mean_error(records, k) for k in keys} for who, (records, _) in c.items()}
            for row, c in rows.items()
        }
        for key, rows in cells.items()
    }
    return section


def _show_table_1(section: Section, cells: dict[str, dict[str, dict[str, Cell]]]) -> None:
    doubling = np.sqrt(CAPTURE_RATE_HZ / common.FPS)
    rows: list[Sequence[object]] = []
    for key, by_row in cells.items():
        category, training = key.split()
        for name, by_solver in by_row.items():
            printed = PAPER_ERRORS_CM.get(name, {}).get(category)
            both = [by_solver.get(who) for who in ('paper', 'joint')]
            rows.append(
                [
                    *(category, 'all motions' if name == 'np all' else training, name),
                    *([f'{printed:.3f}', f'{printed * doubling:.2f}'] if printed else [None, None]),
                    *(c and f'{common.mean_error(c[0], "e_paper_cm"):.3f} ({c[1]})' for c in both),
                    *(c and f'{common.mean_error(c[0]):.1f}' for c in both),
                ]
            )
    section.table(
        [
            'motion', 'training', 'method', 'paper: e, cm', 'paper at 30 fps: e, cm', 'Algorithm 1: e, cm',
            'joint: e, cm', 'Algorithm 1: MPJPE, mm', 'joint: MPJPE, mm',
        ],
        rows,
    )  # fmt: skip


def measure_number_of_base_poses(quick: bool) -> Section:
    """Measure the error against the number of base poses (figures 8 and 9)."""
    section = Section('Number of base poses (figures 8 and 9)')
    counts = (2, 6) if quick else (2, 4, 6, 8, 10, 15, 20, 30, 40)
    trials = {**TABLE_1_TRIALS, 'periodic': '35_02'}
    curves: Curves = {'Algorithm 1': {}, 'project': {}}
    for category, trial in trials.items():
        tests = common.make_views(trial, choose_few_headings(quick))
        motion = 'walk' if category == 'periodic' else category
        paper, ours = train_both(motion, trial)
        for k in counts:
            project = common.make_config(components=k)
            if category == 'periodic':
                solved = [solve_with_paper_sines(tests, paper, k), common.solve_periodically(tests, ours, project)]
            else:
                slow = make_paper_config(components=k, tolerance=1e-3)
                solved = [
                    common.solve_by_alternation(tests, paper, slow),
                    common.solve_jointly(tests, ours, project),
                ]
            for found, curve in zip(solved, curves.values(), strict=True):
                curve.setdefault(category, []).append(_compute_errors(tests, found, ours))
    _show_sweep(section, 'K', counts, curves, 1)
    least = {s: {c: counts[int(np.argmin([e for e, _ in v]))] for c, v in by.items()} for s, by in curves.items()}
    section.text(
        'K with the smallest 3D error: '
        + '; '.join(f'{s}: ' + ', '.join(f'{c} {k}' for c, k in by.items()) for s, by in least.items())
        + '. The paper finds the best K between 4 and 10, and 6 on its test data; more base poses increase the 3D '
        'error and decrease the 2D error.'
    )
    figure, axes = make_panels(2, rows=2, height=4.6, sharex=True, sharey='row')
    for column, by_category in enumerate(curves.values()):
        for category, values in by_category.items():
            for row in (0, 1):
                series = np.array([v[row] for v in values])
                axes[row, column].plot(
                    counts, series / series[0], 'o-', color=CATEGORY_COLOURS[category], label=category
                )
        label_axes(axes[0, column], '', '3D error / that at K = 2', tuple(curves)[column])
        label_axes(axes[1, column], 'number of base poses K', '2D error / that at K = 2')
    axes[0, 0].legend(ncols=2)
    section.figure('fig08_09_base_poses', figure, '3D and 2D error against the number of base poses')
    return section


def _show_sweep(section: Section, name: str, values: Sequence[float], curves: Curves, digits: int) -> None:
    """Show the 3D and 2D errors of each solver against a parameter, with so many digits of the 2D error."""
    for solver, by_trial in curves.items():
        pairs = zip(*by_trial.values(), strict=True)
        rows = [
            [f'{value:g}', *(f'{e:.1f} / {flat:.{digits}f}' for e, flat in each)]
            for value, each in zip(values, pairs, strict=True)
        ]
        section.table([f'{name}, {solver}', *(f'{t}: 3D / 2D, mm' for t in by_trial)], rows)
        section.data[solver] = {name: list(values), **by_trial}


def _compute_errors(
    tests: Sequence[View], found: Sequence[Reconstruction], model: BasePoses
) -> tuple[float, float]:
    """Return the mean 3D and 2D error in mm."""
    flat = float(np.mean([common.compute_residual_mm(v, r) for v, r in zip(tests, found, strict=True)]))
    return common.mean_error(common.compute_all_errors(tests, found, model)), flat


def measure_bone_regulariser(quick: bool) -> Section:
    """Measure the error against the bone-length regulariser (figures 7 and 10)."""
    section = Section('Bone-length regulariser (figures 7 and 10)')
    betas = (0.0, 1.0) if quick else (0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 40.0, 100.0, 1e3, 1e4)
    trials = {'walk': '07_01', 'run': '09_01', 'jump': '13_32', 'walk 35/01': '35_01'}
    curves: Curves = {'Algorithm 1': {}, 'joint': {}}
    for name, trial in trials.items():
        category = name.split()[0]
        tests = common.make_views(trial, choose_few_headings(quick))
        paper, ours = train_both(category, trial)
        for beta in betas:
            slow = common.solve_by_alternation(tests, paper, make_paper_config(bone_weight=beta, tolerance=1e-3))
            fast = common.solve_jointly(tests, ours, common.make_config(bone_weight=beta))
            curves['Algorithm 1'].setdefault(name, []).append(_compute_errors(tests, slow, paper))
            curves['joint'].setdefault(name, []).append(_compute_errors(tests, fast, ours))
    _show_sweep(section, 'beta', betas, curves, 2)
    gains = [
        f'{solver}: ' + ', '.join(f'{n} {1 - min(e for e, _ in v) / v[0][0]:.0%}' for n, v in by_name.items())
        for solver, by_name in curves.items()
    ]
    section.text('Reduction of the 3D error by the best beta: ' + '; '.join(gains) + '.')
    axis = [max(b, min(x for x in betas if x) / 3) for b in betas]
    figure, axes = make_panels(2, sharey=True)
    for ax, (solver, by_name) in zip(axes, curves.items(), strict=True):
        for name in ('walk', 'run', 'jump'):
            series = np.array([e for e, _ in by_name[name]])
            ax.plot(axis, series / series[0], 'o-', color=CATEGORY_COLOURS[name], label=name)
        ax.axhline(1, color=NEUTRAL, linewidth=0.8)
        ax.set_xscale('log')
        label_axes(ax, 'beta (leftmost: 0)', '3D error / that at beta = 0', solver)
    axes[0].set_ylim(0.5, 2.5)
    axes[0].legend()
    section.figure('fig10_beta', figure, '3D error against the bone-length regulariser')
    figure, axes = make_panels(2)
    for ax, (solver, by_name) in zip(axes, curves.items(), strict=True):
        values = np.array(by_name['walk 35/01'])
        ax.plot(axis, values[:, 0], 'o-', color=WALK, label='3D error')
        ax.plot(axis, values[:, 1], 's-', color=RUN, label='2D error')
        ax.set_xscale('log')
        ax.set_ylim(bottom=0)
        label_axes(ax, 'beta (leftmost: 0)', 'error, mm', f'{solver}, walk 35/01')
    axes[0].legend()
    section.figure('fig07_2d_and_3d', figure, '2D and 3D error against the bone-length regulariser')
    return section


def measure_bone_lengths(quick: bool) -> Section:
    """Measure the bone lengths over time (figures 6 and 11)."""
    section = Section('Bone lengths over time (figures 6 and 11)')
    trial, heading = '35_01', 45
    (view,) = tests = common.make_views(trial, [heading])
    model = train_like_paper('walk', trial)
    free = {'bone_weight': 0.0, 'components': 10 if quick else 15}
    (other,) = others = common.make_views('07_01', [heading])
    other_model = train_like_paper('walk', '07_01')
    kinds: dict[str, tuple[View, BasePoses, Reconstruction]] = {
        'unconstrained, 07/01': (
            other, other_model, common.solve_by_alternation(others, other_model, make_paper_config(**free))[0],
        ),
        "periodic (the paper's sines)": (view, model, solve_with_paper_sines(tests, model)[0]),
    }  # fmt: skip
    candidates = {
        b: common.solve_by_alternation(tests, model, make_paper_config(bone_weight=b))[0] for b in (0.3, 1.0, 3.0)
    }
    best = min(
        candidates,
        key=lambda b: common.compute_errors(view, candidates[b].joints, model.skeleton.joints)['mpjpe_mm'],
    )
    kinds[f'best beta ({best:g})'] = (view, model, candidates[best])
    stiff = common.solve_jointly(tests, model, make_paper_config(bone_weight=1e4))[0]
    kinds['beta = 1e4'] = (view, model, stiff)
    relative = solve_with_relative_bones(view.window, model, make_paper_config(bone_weight=best))
    kinds['relative variance'] = (view, model, relative)
    shipped = common.train_base_poses('walk', without_trials=(trial,))
    kinds['project, defaults'] = (view, shipped, common.solve_jointly(tests, shipped)[0])
    rows = []
    figure, axes = make_panels(3, rows=2, height=4.4, sharex=True, sharey=True)
    for ax, (name, (seen, used, result)) in zip(axes.ravel(), kinds.items(), strict=True):
        lengths = common.compute_bone_lengths_mm(result, used)
        time = seen.sequence['timestamps']
        ax.plot(time, lengths - lengths.mean(axis=0), linewidth=0.8)
        ax.set_title(name, loc='left')
        errors = common.compute_errors(seen, result.joints, used.skeleton.joints)
        rows.append(
            [
                name,
                f'{np.ptp(lengths, axis=0).max():.1f}',
                f'{lengths.std(axis=0).mean():.1f}',
                f'{errors["mpjpe_mm"]:.1f}',
                f'{errors["e_paper_cm"]:.3f}',
            ]
        )
    for ax in axes[:, 0]:
        ax.set_ylabel('length less its mean, mm')
    for ax in axes[-1]:
        ax.set_xlabel('time, s')
    section.table(
        ['reconstruction', 'largest variation, mm', 'mean standard deviation, mm', 'MPJPE, mm', 'e, cm'], rows
    )
    section.data['rows'] = rows
    section.figure('fig06_11_bone_lengths', figure, 'Bone lengths over time under different regularisation')
    return section


def measure_printed_norms(quick: bool) -> Section:
    """Measure Algorithm 1 with squared norms and with the norms as the paper prints them (eq. 13 and 21)."""
    section = Section('Squared norms and norms as printed (eq. 13 and 21)')
    betas = (1.0,) if quick else (0.0, 0.1, 1.0, 10.0, 100.0)
    trials = dict(list(TABLE_1_TRIALS.items())[: 1 if quick else 3])
    forms = {'squared': alternation.reconstruct, 'as printed': reconstruct_with_printed_norms}
    rows = []
    for category, trial in trials.items():
        tests = common.make_views(trial, choose_few_headings(quick))
        model = train_like_paper(category, trial)
        for form, solve in forms.items():
            errors = {}
            for beta in betas:
                config = make_paper_config(bone_weight=beta, tolerance=1e-3)
                found = [solve(v.window, model, config) for v in tests]
                errors[beta] = common.mean_error(common.compute_all_errors(tests, found, model))
            best = min(errors, key=lambda beta: errors[beta])
            rows.append([f'{category} {trial.replace("_", "/")}', form, f'{best:g}', f'{errors[best]:.1f}'])
    section.table(['motion', 'norms', 'best beta', 'MPJPE, mm'], rows)
    section.data['rows'] = rows
    return section
