"""The periodic assumption: fitted sines (figure 5), classification (figure 19), and further claims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import common
import numpy as np
from common import View, make_paper_config
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from experiments.accuracy import choose_few_headings, solve_with_paper_sines, train_both
from experiments.report import JUMP, NEUTRAL, RUN, WALK, Section, label_axes, make_panels
from experiments.variants.sines import solve_with_sines
from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation
from mocap_ros.solvers import periodic
from mocap_ros.solvers.window import Reconstruction, Window

Array = NDArray[np.float64]

# Walks to whose true weights sines are fitted.
SINE_TRIALS = ('35_02', '35_12', '07_01', '16_15')
SECTION_FRAMES = 10  # frames of a section that is classified, as in the paper
# Categories for which the explained variance is printed; empty means all motions.
CLAIM_CATEGORIES = ('walk', 'run', 'jump', 'walk+run+jump', '')


def measure_sines(quick: bool) -> Section:
    """Fit sines to the true weights of the base poses (figure 5)."""
    section = Section('Sines fitted to ground-truth weights (figure 5)')
    rows = []
    drawn: tuple[Array, Array, Array] | None = None
    for trial in SINE_TRIALS[:1] if quick else SINE_TRIALS:
        model = common.train_base_poses('walk', only_subjects=(trial[:2],), plain=True)
        poses = next(t.poses for t in common.list_trials() if t.name == trial)[:120]
        poses = poses * (np.linalg.norm(model.mean) / np.linalg.norm(centre_poses(poses), axis=(1, 2)).mean())
        body = centre_poses(poses) @ np.swapaxes(fit_heading_rotation(centre_poses(poses), model.mean), -1, -2)
        times = np.arange(len(body)) / common.FPS
        theta = model.weights(body)
        forms = {
            'one sine per base pose, K = 4 (the paper)': (4, 1, True),
            'shared fundamental, H = 1, K = 4': (4, 1, False),
            'shared fundamental, H = 2, K = 4': (4, 2, False),
            'shared fundamental, H = 2, all base poses': (len(model.std), 2, False),
            'shared fundamental, H = 3, all base poses': (len(model.std), 3, False),
        }
        cells = []
        for k, harmonics, sines in forms.values():
            fit = fit_harmonics(theta[:, :k], times, harmonics, sines)
            difference = model.truncate(k).poses(fit) - body
            cells.append(
                f'{np.abs(difference).mean() * 1e3:.2f} / {np.linalg.norm(difference, axis=-1).mean() * 1e3:.1f}'
            )
            if trial == SINE_TRIALS[0] and sines:
                drawn = times, theta[:, :4], fit
        rows.append([trial.replace('_', '/'), *cells])
    section.table(['trial', *forms], rows)
    section.data['rows'] = rows
    if drawn is not None:
        times, theta, fit = drawn
        figure, axes = make_panels(2, sharey=True)
        for ax, values, title in zip(axes, (theta, fit), ('ground truth', 'fitted sines'), strict=True):
            for k, colour in enumerate((WALK, RUN, JUMP, NEUTRAL)):
                ax.plot(times, values[:, k], color=colour, label=f'base pose {k + 1}')
            label_axes(ax, 'time, s', 'weight, m' if ax is axes[0] else '', f'{title}, walk 35/02')
        figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
        section.figure('fig05_sines', figure, 'True weights and fitted sines')
    return section


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


def measure_classification(quick: bool) -> Section:
    """Measure the residual of the periodic model over a run, a jump and a run (figure 19)."""
    section = Section('Run, jump, run (figure 19)')
    body, parts = make_splice()
    model = common.train_base_poses('run', only_subjects=('35',), without_trials=('35_17', '35_18'))
    headings = (90,) if quick else (45, 90, 135)
    tests = common.make_views(body, headings, frames=len(body))
    starts = range(0, len(body) - SECTION_FRAMES + 1, SECTION_FRAMES // (1 if quick else 2))
    forms = {
        'project': (periodic.solve, common.make_config(bone_weight=0.0), model),
        "the paper's sines, K = 6": (
            solve_with_sines,
            make_paper_config(),
            common.train_base_poses('run', only_subjects=('35',), without_trials=('35_17', '35_18'), plain=True),
        ),
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
        area = _compute_roc_area(values[~jumping], values[jumping])
        rows.append(
            [
                name,
                f'{values[~jumping].mean():.3f} (at most {values[~jumping].max():.3f})',
                f'{values[jumping].mean():.3f} (at least {values[jumping].min():.3f})',
                f'{area:.2f}',
            ]
        )
        section.data[name] = {'start_frame': list(starts), 'residual': values}
    section.table(
        ['periodic model', '2D error in the runs', '2D error in the jump', 'area under the ROC curve'], rows
    )
    figure, axes = make_panels(1, height=2.6)
    for (name, values), colour in zip(residuals.items(), (RUN, WALK), strict=True):
        axes[0].plot(middle / common.FPS, values, 'o-', color=colour, label=name)
    axes[0].axvspan(parts[1][1] / common.FPS, parts[1][2] / common.FPS, color='#f0f0f0', zorder=0, label='jump')
    label_axes(axes[0], 'middle of the section, s', '2D error / body size')
    axes[0].set_ylim(bottom=0)
    axes[0].legend()
    section.figure('fig19_classification', figure, '2D error of the periodic model over a run, a jump and a run')
    return section


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


def measure_claims(quick: bool) -> Section:
    """Measure the claims that the paper makes beside its experiments."""
    section = Section('Further claims')
    _measure_explained_variance(section, CLAIM_CATEGORIES[:3] if quick else CLAIM_CATEGORIES)
    _measure_periodic_bones(section, quick)
    return section


def _measure_explained_variance(section: Section, categories: Sequence[str]) -> None:
    section.text(
        'Share of the variance in the first ten base poses, all trials of the category (the paper: over 99 %).'
    )
    rows = []
    for category in categories:
        chosen = [
            t.poses
            for t in common.list_trials()
            if t.clean and (not category or t.category in category.split('+'))
        ]
        stacked = centre_poses(np.concatenate(chosen)).reshape(-1, chosen[0].shape[1] * 3)
        variance = np.linalg.eigvalsh(np.cov(stacked.T))[::-1]
        raw = variance[:10].sum() / variance.sum()
        aligned = common.train_base_poses(category, plain=True).explained[9]
        shipped = common.train_base_poses(category).explained[9]
        count = int(np.searchsorted(np.cumsum(variance) / variance.sum(), 0.99)) + 1
        rows.append([category or 'all motions', f'{raw:.1%}', count, f'{aligned:.1%}', f'{shipped:.1%}'])
    section.table(
        [
            'category',
            'as in the paper, not aligned',
            'base poses needed for 99 %',
            'aligned',
            'as shipped (with mirrored poses and other bodies)',
        ],
        rows,
    )
    section.data['ten components'] = rows


def _measure_periodic_bones(section: Section, quick: bool) -> None:
    weights = (0.0, 20.0) if quick else (0.0, 0.1, 1.0, 5.0, 20.0, 100.0, 1e3, 1e4)
    trials: Sequence[tuple[str, str]] = (('35_02', 'walk'),) if quick else (('35_02', 'walk'), ('35_17', 'run'))
    rows = []
    for beta in weights:
        cells = []
        for trial, category in trials:
            tests = common.make_views(trial, choose_few_headings(quick))
            paper, ours = train_both(category, trial)
            by_model = (
                (paper, solve_with_paper_sines(tests, paper, bone_weight=beta)),
                (ours, common.solve_periodically(tests, ours, common.make_config(bone_weight=beta))),
            )
            for model, found in by_model:
                cells.append(f'{common.mean_error(common.compute_all_errors(tests, found, model)):.1f}')
        rows.append([f'{beta:g}', *cells])
    section.text(
        """Bone-length term in the periodic model, MPJPE in mm. The paper: no improvement, and with too high a
        weight the skeleton stays in the mean pose."""
    )
    header = [f'{t}, {form}' for t, _ in trials for form in ("the paper's sines, K = 4", 'project')]
    section.table(['beta', *header], rows)
    section.data['periodic bones'] = rows
