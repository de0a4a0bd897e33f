# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Table 1, and the error against the number of base poses and the bone regulariser (figures 6 to 11)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any

import common
import numpy as np
from common import View, make_paper_config
from panels import COLOURS, NEUTRAL, RUN, WALK, draw_curves, label_axes, make_panels
from report import Report

from experiments.methods import (
    ALGORITHM_1,
    JOINT,
    PERIODIC,
    SINES,
    Method,
    Scores,
    choose_few_headings,
    choose_headings,
    compute_mean_errors,
)
from experiments.variants.frobenius import reconstruct_with_printed_norms
from experiments.variants.relative_bones import solve_with_relative_bones
from mocap_ros.config import SolverConfig
from mocap_ros.skeleton import CMU15
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

Cell = tuple[Scores, str]  # errors by view, and the setting
Curves = Mapping[str, Mapping[str, Sequence[tuple[float, float]]]]  # mm, 3D and 2D errors by solver and trial


def find_best_regulariser(
    method: Method, category: str, betas: Sequence[float], *, tests: Sequence[View], trial: str, **values: Any
) -> Cell:
    """Return the errors with the regulariser whose mean error is smallest, as in the row `best`, and its name."""
    found = {b: method.score(tests, category, trial, bone_weight=b, **values) for b in betas}
    best = min(found, key=lambda beta: common.mean_error(found[beta], 'e_paper_cm'))
    return found[best], f'beta {best:g}'


def measure_table_1(report: Report, quick: bool) -> dict[str, Any]:
    """Table 1: walk, run, jump."""
    betas, default = BETAS[3:4] if quick else BETAS, SolverConfig().bone_weight
    trials = list(TABLE_1_TRIALS.items())[: 2 if quick else 3]
    cells: dict[str, dict[str, dict[str, Cell]]] = {}
    for (category, trial), training in product(trials, ('category',) if quick else ('own', 'category')):
        tests, own = common.make_views(trial, choose_headings(quick)), training == 'own'
        find = partial(find_best_regulariser, tests=tests, trial=trial, own=own)
        rows: dict[str, dict[str, Cell]] = {}
        if category != 'jump':
            sines, series = (m.score(tests, category, trial, own=own) for m in (SINES, PERIODIC))
            rows['periodic'] = {'paper': (sines, 'K = 4'), 'joint': (series, f'H = {SolverConfig().harmonics}')}
        rows |= {
            'np (beta = 0)': {
                'paper': find(ALGORITHM_1, category, (0.0,)),
                'joint': find(JOINT, category, (0.0,)),
            },
            'best': {
                'paper': find(ALGORITHM_1, category, betas, tolerance=2e-4),
                'joint': find(JOINT, category, (*betas, default)),
            },
            'joint solver, defaults': {'joint': find(JOINT, category, (default,))},
        }
        if not own:
            rows['np all'] = {
                'paper': find(ALGORITHM_1, '', betas, components=15, tolerance=2e-4),
                'joint': find(JOINT, '', (default,)),
            }
        cells[f'{category} {training}'] = rows
    _show_table_1(report, cells)
    keys = ('e_paper_cm', 'mpjpe_mm', 'pa_mpjpe_mm')
    return {
        'cells': {
            key: {
                row: {who: {k: common.mean_error(records, k) for k in keys} for who, (records, _) in c.items()}
                for row, c in rows.items()
            }
            for key, rows in cells.items()
        }
    }


def _show_table_1(report: Report, cells: Mapping[str, Mapping[str, Mapping[str, Cell]]]) -> None:
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
    header = ['motion', 'training', 'method', 'paper: e, cm', 'paper at 30 fps: e, cm']
    solvers = ('Algorithm 1', 'joint')
    report.table([*header, *(f'{s}: e, cm' for s in solvers), *(f'{s}: MPJPE, mm' for s in solvers)], rows)


def measure_number_of_base_poses(report: Report, quick: bool) -> dict[str, Any]:
    """Number of base poses (figures 8 and 9)."""
    counts = (2, 6) if quick else (2, 4, 6, 8, 10, 15, 20, 30, 40)
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {'Algorithm 1': {}, 'project': {}}
    for name, trial in {**TABLE_1_TRIALS, 'periodic': '35_02'}.items():
        tests = common.make_views(trial, choose_few_headings(quick))
        category, paper, ours = name, ALGORITHM_1, JOINT
        slow: dict[str, Any] = {'tolerance': 1e-3}
        if name == 'periodic':
            category, paper, ours, slow = 'walk', SINES, PERIODIC, {}
        for method, values, curve in zip((paper, ours), (slow, {}), curves.values(), strict=True):
            found = [method.solve(tests, category, trial, components=k, **values) for k in counts]
            curve[name] = [compute_mean_errors(tests, f) for f in found]
    data = _show_sweep(report, 'K', counts, curves, 1)
    least = {s: {c: counts[int(np.argmin([e for e, _ in v]))] for c, v in by.items()} for s, by in curves.items()}
    report.text(
        'K with the smallest 3D error: '
        + '; '.join(f'{s}: ' + ', '.join(f'{c} {k}' for c, k in by.items()) for s, by in least.items())
        + '. The paper finds the best K between 4 and 10, and 6 on its test data; more base poses increase the 3D '
        'error and decrease the 2D error.'
    )
    figure, axes = make_panels(2, rows=2, height=4.6, sharex=True, sharey='row')
    for column, (solver, by_category) in enumerate(curves.items()):
        for row in (0, 1):
            series = {c: np.array([v[row] for v in values]) / values[0][row] for c, values in by_category.items()}
            draw_curves(axes[row, column], counts, series, list(COLOURS.values()))
        label_axes(axes[0, column], '', '3D error / that at K = 2', solver)
        label_axes(axes[1, column], 'number of base poses K', '2D error / that at K = 2')
    axes[0, 0].legend(ncols=2)
    report.paper_figure('fig08_09_base_poses', figure, '3D and 2D error against the number of base poses')
    return data


def _show_sweep(report: Report, name: str, values: Sequence[float], curves: Curves, digits: int) -> dict[str, Any]:
    """Show the 3D and 2D errors of each solver against a parameter, with so many digits of the 2D error."""
    for solver, by_trial in curves.items():
        rows = [
            [f'{value:g}', *(f'{e:.1f} / {flat:.{digits}f}' for e, flat in each)]
            for value, each in zip(values, zip(*by_trial.values(), strict=True), strict=True)
        ]
        report.table([f'{name}, {solver}', *(f'{t}: 3D / 2D, mm' for t in by_trial)], rows)
    return {solver: {name: list(values), **by_trial} for solver, by_trial in curves.items()}


def measure_bone_regulariser(report: Report, quick: bool) -> dict[str, Any]:
    """Bone-length regulariser (figures 7 and 10)."""
    betas = (0.0, 1.0) if quick else (0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 40.0, 100.0, 1e3, 1e4)
    trials = {'walk': '07_01', 'run': '09_01', 'jump': '13_32', 'walk 35/01': '35_01'}
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {}
    configured: dict[Method, dict[str, Any]] = {ALGORITHM_1: {'tolerance': 1e-3}, JOINT: {}}
    for method, values in configured.items():
        curves[method.name] = {}
        for name, trial in trials.items():
            tests, category = common.make_views(trial, choose_few_headings(quick)), name.split()[0]
            found = [method.solve(tests, category, trial, bone_weight=b, **values) for b in betas]
            curves[method.name][name] = [compute_mean_errors(tests, f) for f in found]
    data = _show_sweep(report, 'beta', betas, curves, 2)
    gains = [
        f'{solver}: ' + ', '.join(f'{n} {1 - min(e for e, _ in v) / v[0][0]:.0%}' for n, v in by_name.items())
        for solver, by_name in curves.items()
    ]
    report.text('Reduction of the 3D error by the best beta: ' + '; '.join(gains) + '.')
    _draw_bone_regulariser(report, [max(b, min(x for x in betas if x) / 3) for b in betas], curves)
    return data


def _draw_bone_regulariser(report: Report, betas: Sequence[float], curves: Curves) -> None:
    figure, axes = make_panels(2, sharey=True)
    for ax, (solver, by_name) in zip(axes, curves.items(), strict=True):
        series = {n: np.array([e for e, _ in by_name[n]]) / by_name[n][0][0] for n in ('walk', 'run', 'jump')}
        draw_curves(ax, betas, series, [COLOURS[n] for n in series])
        ax.axhline(1, color=NEUTRAL, linewidth=0.8)
        ax.set_xscale('log')
        label_axes(ax, 'beta (leftmost: 0)', '3D error / that at beta = 0', solver)
    axes[0].set_ylim(0.5, 2.5)
    axes[0].legend()
    report.paper_figure('fig10_beta', figure, '3D error against the bone-length regulariser')
    figure, axes = make_panels(2)
    for ax, (solver, by_name) in zip(axes, curves.items(), strict=True):
        values = np.array(by_name['walk 35/01'])
        draw_curves(ax, betas, {'3D error': values[:, 0], '2D error': values[:, 1]}, (WALK, RUN))
        ax.set_xscale('log')
        ax.set_ylim(bottom=0)
        label_axes(ax, 'beta (leftmost: 0)', 'error, mm', f'{solver}, walk 35/01')
    axes[0].legend()
    report.paper_figure('fig07_2d_and_3d', figure, '2D and 3D error against the bone-length regulariser')


def measure_bone_lengths(report: Report, quick: bool) -> dict[str, Any]:
    """Bone lengths over time (figures 6 and 11)."""
    (view,) = common.make_views('35_01', [45])
    (other,) = common.make_views('07_01', [45])

    def solve(method: Method, **values: Any) -> Reconstruction:
        return method.solve([view], 'walk', '35_01', **values)[0]

    free: dict[str, Any] = {'bone_weight': 0.0, 'components': 10 if quick else 15}
    (unconstrained,) = ALGORITHM_1.solve([other], 'walk', '07_01', **free)
    candidates = {b: solve(ALGORITHM_1, bone_weight=b) for b in (0.3, 1.0, 3.0)}
    best = min(candidates, key=lambda b: common.compute_all_errors([view], [candidates[b]])[0]['mpjpe_mm'])
    paper, stiff = ALGORITHM_1.train('walk', '35_01'), make_paper_config(bone_weight=1e4)
    relative = solve_with_relative_bones(view.window, paper, make_paper_config(bone_weight=best))
    kinds = {
        'unconstrained, 07/01': unconstrained,
        "periodic (the paper's sines)": solve(SINES),
        f'best beta ({best:g})': candidates[best],
        'beta = 1e4': common.solve_jointly([view], paper, stiff)[0],
        'relative variance': relative,
        'project, defaults': solve(JOINT),
    }
    rows = []
    figure, axes = make_panels(3, rows=2, height=4.4, sharex=True, sharey=True)
    for ax, (name, result) in zip(axes.ravel(), kinds.items(), strict=True):
        seen = other if result is unconstrained else view
        lengths = CMU15.bone_lengths(result.joints) * 1e3
        ax.plot(seen.sequence['timestamps'], lengths - lengths.mean(axis=0), linewidth=0.8)
        ax.set_title(name, loc='left')
        (errors,) = common.compute_all_errors([seen], [result])
        variation = f'{np.ptp(lengths, axis=0).max():.1f}', f'{lengths.std(axis=0).mean():.1f}'
        rows.append([name, *variation, f'{errors["mpjpe_mm"]:.1f}', f'{errors["e_paper_cm"]:.3f}'])
    for ax in axes[:, 0]:
        ax.set_ylabel('length less its mean, mm')
    for ax in axes[-1]:
        ax.set_xlabel('time, s')
    header = ['reconstruction', 'largest variation, mm', 'mean standard deviation, mm', 'MPJPE, mm', 'e, cm']
    report.table(header, rows)
    report.paper_figure('fig06_11_bone_lengths', figure, 'Bone lengths over time under different regularisation')
    return {'rows': rows}


def measure_printed_norms(report: Report, quick: bool) -> dict[str, Any]:
    """Squared norms and norms as printed (eq. 13 and 21)."""
    betas = (1.0,) if quick else (0.0, 0.1, 1.0, 10.0, 100.0)
    forms = {'squared': alternation.reconstruct, 'as printed': reconstruct_with_printed_norms}
    rows = []
    for category, trial in list(TABLE_1_TRIALS.items())[: 1 if quick else 3]:
        tests, model = common.make_views(trial, choose_few_headings(quick)), ALGORITHM_1.train(category, trial)
        for form, solve in forms.items():
            errors = {}
            for beta in betas:
                config = make_paper_config(bone_weight=beta, tolerance=1e-3)
                found = [solve(v.window, model, config) for v in tests]
                errors[beta] = common.mean_error(common.compute_all_errors(tests, found))
            best = min(errors, key=lambda beta: errors[beta])
            rows.append([f'{category} {trial.replace("_", "/")}', form, f'{best:g}', f'{errors[best]:.1f}'])
    report.table(['motion', 'norms', 'best beta', 'MPJPE, mm'], rows)
    return {'rows': rows}
