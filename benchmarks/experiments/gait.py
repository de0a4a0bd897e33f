# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The periodic assumption: fitted sines (figure 5), classification (figure 19), and further claims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import common
import numpy as np
from common import View, make_paper_config
from numpy.typing import NDArray
from panels import RUN, WALK, draw_curves, draw_weights, label_axes, make_panels
from report import Report
from scipy.optimize import minimize_scalar

from experiments.methods import PERIODIC, SINES, choose_few_headings
from experiments.variants.sines import solve_with_sines
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.solvers import periodic
from mocap_ros.solvers.window import Reconstruction, Window

Array = NDArray[np.float64]

# Walks to whose true weights sines are fitted.
SINE_TRIALS = ('35_02', '35_12', '07_01', '16_15')
SECTION_FRAMES = 10  # frames of a section that is classified, as in the paper
# Categories for which the explained variance is printed; empty means all motions.
CLAIM_CATEGORIES = ('walk', 'run', 'jump', 'walk+run+jump', '')


def measure_sines(report: Report, quick: bool) -> dict[str, Any]:
    """Sines fitted to ground-truth weights (figure 5)."""
    rows, drawn = [], {}
    for trial in SINE_TRIALS[:1] if quick else SINE_TRIALS:
        model = common.train_base_poses('walk', only_subjects=(trial[:2],), plain=True)
        body, theta = common.find_true_weights(model, trial, 120)
        times = np.arange(len(body)) / common.FPS
        every = len(model.std)
        forms = {
            'one sine per base pose, K = 4 (the paper)': (4, 1, True),
            'shared fundamental, H = 1, K = 4': (4, 1, False),
            'shared fundamental, H = 2, K = 4': (4, 2, False),
            'shared fundamental, H = 2, all base poses': (every, 2, False),
            'shared fundamental, H = 3, all base poses': (every, 3, False),
        }
        cells = []
        for k, harmonics, sines in forms.values():
            fit = fit_harmonics(theta[:, :k], times, harmonics, sines)
            difference = model.truncate(k).poses(fit) - body
            distance = np.linalg.norm(difference, axis=-1).mean()
            cells.append(f'{np.abs(difference).mean() * 1e3:.2f} / {distance * 1e3:.1f}')
            if trial == SINE_TRIALS[0] and sines:
                drawn = {'ground truth, walk 35/02': theta, 'fitted sines, walk 35/02': fit}
        rows.append([trial.replace('_', '/'), *cells])
    report.table(['trial', *forms], rows)
    figure, axes = make_panels(2, sharey=True)
    draw_weights(axes, np.arange(len(drawn['ground truth, walk 35/02'])) / common.FPS, drawn)
    report.paper_figure('fig05_sines', figure, 'True weights and fitted sines')
    return {'rows': rows}


def fit_harmonics(theta: Array, times: Array, harmonics: int, sines: bool) -> Array:
    """Fit the paper's sines, or series with a constant and one shared fundamental, to weights (F, K)."""
    if sines:
        return np.stack(
            [_fit_series(theta[:, [k]], times, 1, constant=False)[:, 0] for k in range(theta.shape[1])], -1
        )
    return _fit_series(theta, times, harmonics, constant=True)


def _fit_series(theta: Array, times: Array, harmonics: int, *, constant: bool) -> Array:
    h = np.arange(1, harmonics + 1)

    def fit(hertz: float) -> Array:
        angle = 2 * np.pi * hertz * times[:, None] * h
        terms = [np.cos(angle), np.sin(angle)] + ([np.ones((len(times), 1))] if constant else [])
        basis = np.concatenate(terms, axis=1)
        return basis @ np.linalg.lstsq(basis, theta, rcond=None)[0]

    def misfit(hertz: float) -> float:
        return float(((fit(hertz) - theta) ** 2).sum())

    scanned = np.arange(0.3, 4.5, 0.02) if not constant else np.arange(0.5, 2.2, 0.02)
    best = scanned[int(np.argmin([misfit(f) for f in scanned]))]
    refined = minimize_scalar(misfit, bounds=(best - 0.02, best + 0.02), method='bounded')
    return fit(float(refined.x))


def make_splice() -> tuple[Array, list[tuple[str, int, int]]]:
    """Concatenate 35/17, the jump of 13/11 and 35/18, facing one way: poses (F, 15, 3) mm, and the parts."""
    motion, joints = common.load_capture()
    jump = motion['13_11']
    height = jump[:, joints.index('pelvis'), 1]
    top = int(np.argmax(height))
    parts = [
        ('run 35/17', motion['35_17']),
        ('jump 13/11', jump[max(top - 20, 0) : top + 20]),
        ('run 35/18', motion['35_18']),
    ]
    left, right = joints.index('lhip'), joints.index('rhip')
    turned, bounds, at = [], [], 0
    for name, xyz in parts:
        across = (xyz[:, left] - xyz[:, right]).mean(axis=0)
        angle = np.arctan2(across[2], across[0])
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        turned.append((xyz - xyz.mean(axis=1, keepdims=True)) @ rotation.T)
        bounds.append((name, at, at + len(xyz)))
        at += len(xyz)
    return np.concatenate(turned), bounds


def measure_classification(report: Report, quick: bool) -> dict[str, Any]:
    """Run, jump, run (figure 19)."""
    body, parts = make_splice()
    train = partial(common.train_base_poses, 'run', only_subjects=('35',), without_trials=('35_17', '35_18'))
    headings = (90,) if quick else (45, 90, 135)
    tests = common.make_views(body, headings, frames=len(body))
    starts = range(0, len(body) - SECTION_FRAMES + 1, SECTION_FRAMES // (1 if quick else 2))
    forms = {
        'project': (periodic.solve, common.make_config(bone_weight=0.0), train()),
        "the paper's sines, K = 6": (solve_with_sines, make_paper_config(), train(plain=True)),
    }
    residuals: dict[str, Array] = {}
    size = float(np.linalg.norm(centre_poses(body), axis=(1, 2)).mean() / np.sqrt(body.shape[1])) * 1e-3
    for name, (solve, config, used) in forms.items():
        per_view = [
            [measure_section_residual(v, s, partial(solve, model=used, config=config)) for s in starts]
            for v in tests
        ]
        residuals[name] = np.mean(per_view, axis=0) / (size * 1e3)
    middle = np.array([s + SECTION_FRAMES / 2 for s in starts])
    jumping = np.array([parts[1][1] <= m < parts[1][2] for m in middle])
    rows = []
    for name, values in residuals.items():
        running, jump = values[~jumping], values[jumping]
        most, least = f'at most {running.max():.3f}', f'at least {jump.min():.3f}'
        cells = f'{running.mean():.3f} ({most})', f'{jump.mean():.3f} ({least})'
        rows.append([name, *cells, f'{_compute_roc_area(running, jump):.2f}'])
    header = ['periodic model', '2D error in the runs', '2D error in the jump', 'area under the ROC curve']
    report.table(header, rows)
    figure, axes = make_panels(1, height=2.6)
    draw_curves(axes[0], middle / common.FPS, residuals, (RUN, WALK))
    axes[0].axvspan(parts[1][1] / common.FPS, parts[1][2] / common.FPS, color='#f0f0f0', zorder=0, label='jump')
    label_axes(axes[0], 'middle of the section, s', '2D error / body size')
    axes[0].set_ylim(bottom=0)
    axes[0].legend()
    report.paper_figure(
        'fig19_classification', figure, '2D error of the periodic model over a run, a jump and a run'
    )
    return {name: {'start_frame': list(starts), 'residual': values} for name, values in residuals.items()}


def measure_section_residual(
    view: View, start: int, solve: Callable[[Sequence[Window]], Sequence[Reconstruction]]
) -> float:
    """Return the 2D error of a periodic model on one section in mm."""
    w, own = view.window, slice(start, start + SECTION_FRAMES)
    (result,) = solve([Window(w.points[own], w.weight[own], w.times[own])])
    return float(np.sqrt((result.residual**2).mean()) / common.load_protocol().PX_PER_M * 1e3)


def _compute_roc_area(below: Array, above: Array) -> float:
    """Return the probability that a value of `above` exceeds a value of `below`."""
    return float((above[:, None] > below).mean() + 0.5 * (above[:, None] == below).mean())


def measure_claims(report: Report, quick: bool) -> dict[str, Any]:
    """Further claims."""
    return {
        'ten components': _measure_explained_variance(report, CLAIM_CATEGORIES[:3] if quick else CLAIM_CATEGORIES),
        'periodic bones': _measure_periodic_bones(report, quick),
    }


def _measure_explained_variance(report: Report, categories: Sequence[str]) -> list[Sequence[object]]:
    share = 'Share of the variance in the first ten base poses, all trials of the category'
    report.text(f'{share} (the paper: over 99 %).')
    rows: list[Sequence[object]] = []
    for category in categories:
        kinds = category.split('+') if category else []
        poses = [t.poses for t in common.list_trials() if t.clean and (not kinds or t.category in kinds)]
        stacked = centre_poses(np.concatenate(poses)).reshape(-1, poses[0].shape[1] * 3)
        variance = np.linalg.eigvalsh(np.cov(stacked.T))[::-1]
        raw = variance[:10].sum() / variance.sum()
        count = int(np.searchsorted(np.cumsum(variance) / variance.sum(), 0.99)) + 1
        trained = [common.train_base_poses(category, plain=plain).explained[9] for plain in (True, False)]
        rows.append([category or 'all motions', f'{raw:.1%}', count, *(f'{share:.1%}' for share in trained)])
    needed, shipped = 'base poses needed for 99 %', 'as shipped (with mirrored poses and other bodies)'
    report.table(['category', 'as in the paper, not aligned', needed, 'aligned', shipped], rows)
    return rows


def _measure_periodic_bones(report: Report, quick: bool) -> list[list[str]]:
    weights = (0.0, 20.0) if quick else (0.0, 0.1, 1.0, 5.0, 20.0, 100.0, 1e3, 1e4)
    trials = (('35_02', 'walk'),) if quick else (('35_02', 'walk'), ('35_17', 'run'))
    cases = [(method, trial, category) for trial, category in trials for method in (SINES, PERIODIC)]
    views = {trial: common.make_views(trial, choose_few_headings(quick)) for trial, _ in trials}
    rows = []
    for beta in weights:
        scores = [m.score(views[trial], category, trial, bone_weight=beta) for m, trial, category in cases]
        rows.append([f'{beta:g}', *(f'{common.mean_error(s):.1f}' for s in scores)])
    report.text(
        """Bone-length term in the periodic model, MPJPE in mm. The paper: no improvement, and with too high a
        weight the skeleton stays in the mean pose."""
    )
    names = {SINES: "the paper's sines, K = 4", PERIODIC: 'project'}
    report.table(['beta', *(f'{trial}, {names[method]}' for method, trial, _ in cases)], rows)
    return rows
