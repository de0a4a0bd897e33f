# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The experiments of TPAMI 2016, section 4, with the paper's Algorithm 1 and this project's solvers.

CMU motion capture at 30 Hz, orthographic views from 8 headings, the first 120 frames. Algorithm 1 is as printed:
no prior, no smoothness, K = 6, squared norms. Np is the non-periodic model. Nothing was trained on the tested
trial. Sections of `--only`:

    table1   table 1: errors e (eq. 25) in cm and MPJPE, by training and regulariser
    targets  this project with the base poses alone as its prior, of the person and of others
    claims   a row for each further figure or claim of the paper
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import common
import numpy as np
from common import View
from numpy.typing import NDArray
from report import Report, run

from mocap_ros.config import SolverConfig
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.geometry.weak_perspective import fit_cameras_closed_form
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers import alternation, joint, periodic
from mocap_ros.solvers.window import InitialValues, Reconstruction, Window

Array = NDArray[np.float64]
Scores = list[dict[str, float]]  # errors by the protocol, one record for each view
Row = Sequence[object]  # of the claims: claim, paper, Algorithm 1, joint solver, periodic model

# Trial of each category in table 1.
TABLE_1_TRIALS = {'walk': '35_02', 'run': '35_17', 'jump': '13_11'}
# cm, the values of e that the paper prints, by row and category.
PRINTED_CM: dict[str, dict[str, float]] = {
    'periodic': {'walk': 0.784, 'run': 0.968},
    'np (beta = 0)': {'walk': 0.295, 'run': 0.661, 'jump': 1.226},
    'best': {'walk': 0.183, 'run': 0.523, 'jump': 1.090},
    'np all': {'walk': 0.334, 'run': 2.805, 'jump': 1.313},
}
DOUBLING = 2.0  # of e, which grows with the root of the frames: the paper's trials may have 120 Hz
BETAS = (0.0, 0.1, 0.3, 1.0, 3.0)  # weights of the bone regulariser among which the row `best` chooses
SAME_SUBJECT_TRIALS = (('35_02', 'walk', 5.0), ('35_17', 'run', 10.0), ('09_01', 'run', 10.0))  # and targets, mm
UNSEEN_TRIALS = (('35_02', 'walk'), ('07_01', 'walk'), ('16_15', 'walk'), ('35_17', 'run'), ('09_01', 'run'))
CAMERAS: dict[str, dict[str, Any]] = {  # options of the protocol
    'fixed': {},
    'orbiting at 30 degrees/s': {'orbit': 30.0},
    'shaken by 5 degrees': {'shake': 5.0},
    'orbiting and shaken': {'orbit': 30.0, 'shake': 5.0},
}
CLAIM_SUBJECTS = ('07', '09', '13', '16', '35')  # of the sequences of figures 12 and 13, as in the paper
HIDDEN = {  # figures 14 and 15
    'legs hidden for a second': (('lknee', 'lankle', 'rknee', 'rankle'), slice(24, 54)),
    'the far arm hidden throughout': (('lshoulder', 'lelbow', 'lwrist'), slice(None)),
}
MIN_FLIP_DEG = 30.0  # degrees between two frames; no camera of the tests turns as fast
SECTION_FRAMES = 10  # frames of a section that is classified, as in the paper
PAPER_VALUES: dict[str, Any] = {
    'method': 'alternation', 'components': 6, 'bone_weight': 1.0, 'flip_weight': 1e-4, 'max_iterations': 100,
    'heading_flip_factor': 1.0, 'heading_prior_factor': 1.0, 'adapt_noise': False,
    **dict.fromkeys(('prior_weight', 'smooth_weight', 'pose_acceleration_weight', 'robust_scale'), 0.0),
    **dict.fromkeys(('start_window', 'tilt_weight', 'scale_weight'), 0.0),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Method:
    """A solver of windows with base poses and configuration, as it is in the experiments.

    Where it `is_of_paper`, base poses are trained on the poses alone, and the configuration is the paper's.
    """

    solve_windows: Callable[..., Sequence[Reconstruction]]
    is_of_paper: bool = False

    def configure(self, **values: Any) -> SolverConfig:
        return replace(SolverConfig(), **{**(PAPER_VALUES if self.is_of_paper else {}), **values})

    def train(self, category: str, trial: str, *, own: bool = False) -> PoseModel:
        """Train base poses of a category without a trial; `own`: on the trial's subject alone."""
        only = (trial[:2],) if own else ()
        plain = self.is_of_paper and bool(category)  # those of all motions are plain in any case
        return common.train_base_poses(category, without_trials=(trial,), only_subjects=only, plain=plain)

    def solve(
        self, tests: Sequence[View], category: str, trial: str, *, own: bool = False, **values: Any
    ) -> Sequence[Reconstruction]:
        """Solve views with base poses of a category without a trial, and values of the configuration."""
        model = self.train(category, trial, own=own)
        return self.solve_windows([v.window for v in tests], model, self.configure(**values))

    def score(self, tests: Sequence[View], category: str, trial: str, **values: Any) -> Scores:
        """Return the errors of the views; arguments as of `solve`."""
        return common.compute_all_errors(tests, self.solve(tests, category, trial, **values))


def solve_by_alternation(
    windows: Sequence[Window], model: PoseModel, config: SolverConfig
) -> Sequence[Reconstruction]:
    return [alternation.reconstruct(w, model, config) for w in windows]


ALGORITHM_1 = Method(solve_by_alternation, is_of_paper=True)
JOINT = Method(joint.solve_hypotheses)
PERIODIC = Method(lambda windows, *given: [periodic.solve(window, *given) for window in windows])
SLOW: dict[str, Any] = {'tolerance': 1e-3}  # of Algorithm 1, so that sweeps end
METHODS: Sequence[tuple[Method, dict[str, Any]]] = ((ALGORITHM_1, SLOW), (JOINT, {}), (PERIODIC, {}))


def choose_headings(quick: bool) -> tuple[int, ...]:
    return common.HEADINGS_DEG[1:2] if quick else common.HEADINGS_DEG


def make_few_views(trial: str, quick: bool, **options: Any) -> list[View]:
    return common.make_views(trial, (45,) if quick else (0, 45, 90, 135), **options)


def report_table_1(report: Report) -> None:
    quick, default = report.quick, SolverConfig().bone_weight
    betas = BETAS[3:4] if quick else BETAS
    rows: list[Sequence[object]] = []
    trials = list(TABLE_1_TRIALS.items())[: 1 if quick else 3]
    for (category, trial), own in product(trials, (False,) if quick else (True, False)):
        tests = common.make_views(trial, choose_headings(quick))

        def find(
            method: Method, of: str, weights: Sequence[float], own: bool = own, **values: Any
        ) -> tuple[str, str]:
            """Return e with the best regulariser, and the MPJPE."""
            score = partial(method.score, tests, of, trial, own=own, **values)  # noqa: B023
            found = {b: score(bone_weight=b) for b in weights}
            best = min(found, key=lambda b: common.mean_error(found[b], 'e_paper_cm'))
            e, mpjpe = (common.mean_error(found[best], key) for key in ('e_paper_cm', 'mpjpe_mm'))
            return f'{e:.3f} (beta {best:g})', f'{mpjpe:.1f}'

        nothing = (None, None)
        cells = {
            'np (beta = 0)': (find(ALGORITHM_1, category, (0.0,)), find(JOINT, category, (0.0,))),
            'best': (
                find(ALGORITHM_1, category, betas, tolerance=2e-4),
                find(JOINT, category, (*betas, default)),
            ),
            'joint solver, defaults': (nothing, find(JOINT, category, (default,))),
        }
        if cells['joint solver, defaults'] == (nothing, cells['best'][1]):
            del cells['joint solver, defaults']
        if category != 'jump':
            e, mpjpe = find(PERIODIC, category, (default,))
            cells = {'periodic': (nothing, (e.partition(' ')[0], mpjpe))} | cells
        if not own:
            everything = find(ALGORITHM_1, '', betas, components=15, tolerance=2e-4)
            cells['np all'] = everything, find(JOINT, '', (default,))
        for name, (paper, ours) in cells.items():
            printed = PRINTED_CM.get(name, {}).get(category)
            as_printed = [f'{printed:.3f}', f'{printed * DOUBLING:.2f}'] if printed else nothing
            training = 'all motions' if name == 'np all' else 'own' if own else 'category'
            rows.append([category, training, name, *as_printed, paper[0], ours[0], paper[1], ours[1]])
    solvers = ('Algorithm 1', 'joint')
    header = ['motion', 'training', 'method', 'paper: e, cm', 'paper at 30 fps: e, cm']
    header += [f'{s}: {what}' for what in ('e, cm', 'MPJPE, mm') for s in solvers]
    report.table(header, rows, page='paper.table1')


def solve_unseen(headings: Sequence[int], method: Method = JOINT, **options: float) -> dict[str, Scores]:
    """Return the errors of each unseen trial, with base poses of its category without its subject."""
    found = {}
    for trial, category in UNSEEN_TRIALS:
        tests = common.make_views(trial, headings, **options)
        model = common.train_base_poses(category, without_subjects=(trial[:2],))
        results = method.solve_windows([v.window for v in tests], model, SolverConfig())
        found[trial] = common.compute_all_errors(tests, results)
    return found


def average(records: Mapping[str, Scores]) -> tuple[float, str]:
    """Return the mean error over the trials in mm, and a text of their means."""
    means = {t: common.mean_error(r) for t, r in records.items()}
    return float(np.mean(list(means.values()))), ', '.join(f'{t} {m:.1f}' for t, m in means.items())


def report_targets(report: Report) -> None:
    headings, rows = choose_headings(report.quick), list[Sequence[object]]()

    def add(case: str, value: float, goal: float, measured: str = '') -> None:
        verdict = 'reached' if value <= goal else 'not reached'
        rows.append([case, measured or f'{value:.1f} mm', f'{goal:g} mm', verdict])

    for trial, category, goal in SAME_SUBJECT_TRIALS[: 1 if report.quick else 3]:
        tests = common.make_views(trial, headings)
        own, wide = (common.mean_error(JOINT.score(tests, category, trial, own=o)) for o in (True, False))
        case = f'{trial}, {category}; trained on the other {category} trials of subject {trial[:2]}'
        add(case, own, goal, f'{own:.2f} mm (trained on all subjects without this trial: {wide:.1f})')
    fixed = solve_unseen(headings)
    overall, each = average(fixed)
    add(f'subject left out, category known: {each}', overall, 20.0, f'mean {overall:.1f} mm')
    worst = max(r['mpjpe_mm'] for records in fixed.values() for r in records)
    add('subject left out, category known: worst heading', worst, 40.0)
    report.table(['case', 'measured', 'target', 'verdict'], rows, page='paper.targets')


def compute_residual_mm(view: View, result: Reconstruction) -> float:
    """Return the RMS reprojection error of the seen points in mm at the distance of the body."""
    count = (view.window.weight > 0).sum(axis=1)
    squared = np.nansum(np.nan_to_num(result.residual) ** 2 * count) / count.sum()
    return float(np.sqrt(squared) / common.load_protocol().PX_PER_M * 1e3)


def list_sequences(quick: bool) -> list[tuple[str, str]]:
    """List the walks, runs and jumps of the paper's five subjects as (trial, category)."""
    trials = [t for t in common.list_trials() if t.subject in CLAIM_SUBJECTS and t.category in TABLE_1_TRIALS]
    return [(t.name, t.category) for t in trials][:: 36 if quick else 2]


def claim_number_of_base_poses(quick: bool) -> list[Row]:
    """Figures 8 and 9."""
    counts = (6, 40) if quick else (2, 4, 6, 8, 10, 15, 20, 30, 40)
    best: dict[Method, list[str]] = {ALGORITHM_1: [], JOINT: []}
    for (category, trial), (method, cells) in product(TABLE_1_TRIALS.items(), best.items()):
        tests = make_few_views(trial, quick)
        values = SLOW if method is ALGORITHM_1 else {}
        errors = [common.mean_error(method.score(tests, category, trial, components=k, **values)) for k in counts]
        cells.append(f'{counts[int(np.argmin(errors))]}')
    claim = 'figures 8, 9: best number of base poses of a walk, a run and a jump'
    return [[claim, '4 to 10', *map(', '.join, best.values()), None]]


def claim_bone_regulariser(quick: bool) -> list[Row]:
    """Figures 7 and 10."""
    betas = (0.0, 1.0) if quick else (0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 40.0, 100.0)
    gains: dict[Method, list[str]] = {ALGORITHM_1: [], JOINT: []}
    for (category, trial), (method, cells) in product(
        {'walk': '07_01', 'run': '09_01', 'jump': '13_32'}.items(), gains.items()
    ):
        values = SLOW if method is ALGORITHM_1 else {}
        score = partial(method.score, make_few_views(trial, quick), category, trial, **values)
        errors = [common.mean_error(score(bone_weight=b)) for b in betas]
        cells.append(f'{1 - min(errors) / errors[0]:.0%}')
    claim = 'figure 10: reduction of the error of a walk, a run and a jump by the best bone regulariser'
    return [[claim, 'clear', *map(', '.join, gains.values()), None]]


def claim_bone_lengths(_quick: bool) -> list[Row]:
    """Figures 6 and 11."""
    (view,) = common.make_views('35_01', [45])
    cells = []
    for method in (ALGORITHM_1, JOINT, PERIODIC):
        (result,) = method.solve([view], 'walk', '35_01')
        lengths = CMU15.bone_lengths(result.joints) * 1e3
        cells.append(f'{np.ptp(lengths, axis=0).max():.1f} mm')
    return [['figure 11: largest variation of a bone in a walk, best beta', '8 mm', *cells]]


def claim_convergence(quick: bool) -> list[Row]:
    """Figure 12."""
    limits = (1, 3, 10)
    errors: dict[Method, list[list[float]]] = {ALGORITHM_1: [], JOINT: []}
    for trial, category in list_sequences(quick):
        tests = common.make_views(trial, [45])
        for method, found in errors.items():
            solve = partial(method.solve, tests, category, trial, tolerance=0.0)
            found.append([compute_residual_mm(tests[0], solve(max_iterations=n)[0]) for n in limits])
    cells = [', '.join(f'{e:.1f}' for e in np.mean(found, axis=0)) + ' mm' for found in errors.values()]
    return [['figure 12: 2D error after 1, 3 and 10 iterations', 'falls at every step', *cells, None]]


def claim_noisy_starts(quick: bool) -> list[Row]:
    """Figure 13."""
    levels, rng_seed = (0.0, 0.1, 0.3), 1
    cells = []
    for method, values in ((ALGORITHM_1, {**SLOW, 'max_iterations': 40}), (JOINT, {})):
        config, errors = method.configure(**values), []
        for trial, category in list_sequences(quick):
            (view,) = common.make_views(trial, [45])
            model = method.train(category, trial)
            few, window, noisy = model.truncate(config.components), view.window, []
            for level in levels:
                noise = np.random.default_rng(rng_seed).standard_normal((view.frames, *few.mean.shape))
                theta = few.weights(few.mean + level * few.stature * noise)
                image = window.points, window.weight, window.times
                cameras = fit_cameras_closed_form(few.poses(theta), *image, config.start_window)
                noisy.append(replace(window, start=InitialValues(theta, cameras)))
            solve = joint.solve if method is JOINT else solve_by_alternation
            found = [solve([w], model, config)[0] for w in noisy]
            errors.append([e['mpjpe_mm'] for e in common.compute_all_errors([view] * len(levels), found)])
        cells.append(', '.join(f'{e:.1f}' for e in np.mean(errors, axis=0)) + ' mm')
    claim = 'figure 13: MPJPE with initial poses with noise of 0, 10 and 30 % of the stature'
    return [[claim, 'plausible up to 10 %', *cells, None]]


def claim_hidden_limbs(_quick: bool) -> list[Row]:
    """Figures 14 and 15."""
    (whole,) = common.make_views('07_02', [90])
    rows: list[Row] = []
    for name, (joints, frames) in HIDDEN.items():
        view, cells = whole.hide_joints(joints, frames), []
        for method, values in METHODS:
            (result,) = method.solve([view], 'walk', '07_02', **values)
            found, truth = common.align_scale(result.joints, view.true_poses)
            error = np.linalg.norm(found - truth, axis=-1)[frames][:, [CMU15.index(j) for j in joints]]
            cells.append(f'{error.mean() * 1e3:.1f} mm')
        rows.append([f'figures 14, 15: {name}, MPJPE of these joints', 'plausible', *cells])
    return rows


def claim_disturbances(quick: bool) -> list[Row]:
    """Figures 16 and 17."""
    rows: list[Row] = []
    claims = {'missing': ('figure 16', 'missing points', 'np: large maximum; periodic: stable')}
    claims['noise'] = ('figure 17', 'noise', 'np: rises; periodic: nearly constant')
    for option, (figure, name, printed) in claims.items():
        cells = []
        for method, values in METHODS:
            errors = []
            for level in (0.0, 0.2):
                tests = make_few_views('35_01', quick, **{option: level})
                found = method.solve(tests, 'walk', '35_01', **values)
                each = [common.compute_frame_errors(v, r.joints) for v, r in zip(tests, found, strict=True)]
                errors.append(f'{np.mean([e.mean() for e in each]):.1f} / {np.mean([e.max() for e in each]):.1f}')
            cells.append(' to '.join(errors) + ' mm')
        rows.append([f'{figure}: mean / maximum over frames, 0 to 20 % {name}', printed, *cells])
    return rows


def claim_flips(quick: bool) -> list[Row]:
    """Figure 4."""
    cells = []
    for method, values in ((ALGORITHM_1, SLOW), (JOINT, {'heading_flip_factor': 1.0, 'start_window': 0.0})):
        counts = []
        for gamma in (0.0, 1e-2):
            flips = 0
            for category, trial in list(TABLE_1_TRIALS.items())[:2]:
                tests = make_few_views(trial, quick, noise=0.05)
                for result in method.solve(tests, category, trial, flip_weight=gamma, **values):
                    r = result.cameras.rotation
                    cosine = (np.einsum('fij,fij->f', r[1:], r[:-1]) - 1) / 2
                    flips += int((np.degrees(np.arccos(np.clip(cosine, -1, 1))) > MIN_FLIP_DEG).sum())
            counts.append(str(flips))
        cells.append(', '.join(counts))
    return [
        ['figure 4: flips of the camera without and with the flip regulariser, 5 % noise', '3, 0', *cells, None]
    ]


def claim_moving_cameras(quick: bool) -> list[Row]:
    """The main claim: cameras may move."""
    headings, cells = choose_headings(quick), []
    for method, some in ((JOINT, headings), (PERIODIC, headings[::4])):
        found = [average(solve_unseen(some, method, **options))[0] for options in CAMERAS.values()]
        cells.append(', '.join(f'{e:.1f}' for e in found) + ' mm')
    claim = f'MPJPE before a camera that is {", ".join(CAMERAS)}; subject left out'
    return [[claim, 'moving cameras work', None, *cells]]


def make_splice() -> tuple[Array, NDArray[np.bool_]]:
    """Concatenate run 35/17, jump 13/11 and run 35/18, facing one way: poses (F, 15, 3) mm, and who jumps (F,)."""
    motion, joints = common.load_capture()
    jump = motion['13_11']
    top = int(np.argmax(jump[:, joints.index('pelvis'), 1]))
    parts, turned = [motion['35_17'], jump[max(top - 20, 0) : top + 20], motion['35_18']], []
    for xyz in parts:
        across = (xyz[:, joints.index('lhip')] - xyz[:, joints.index('rhip')]).mean(axis=0)
        angle = np.arctan2(across[2], across[0])
        c, s = np.cos(angle), np.sin(angle)
        turned.append((xyz - xyz.mean(axis=1, keepdims=True)) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T)
    return np.concatenate(turned), np.repeat([False, True, False], [len(p) for p in parts])


def claim_classification(quick: bool) -> list[Row]:
    """Figure 19."""
    body, jumps = make_splice()
    model = common.train_base_poses('run', only_subjects=('35',), without_trials=('35_17', '35_18'))
    starts = range(0, len(body) - SECTION_FRAMES + 1, SECTION_FRAMES // (1 if quick else 2))
    residuals = []
    for view in common.make_views(body, (90,) if quick else (45, 90, 135), frames=len(body)):
        w = view.window
        sections = [slice(s, s + SECTION_FRAMES) for s in starts]
        windows = [Window(w.points[s], w.weight[s], w.times[s]) for s in sections]
        found = [periodic.solve(one, model, SolverConfig(bone_weight=0.0)) for one in windows]
        residuals.append([np.sqrt((r.residual**2).mean()) for r in found])
    mean = np.mean(residuals, axis=0)
    is_jump = jumps[np.array(starts) + SECTION_FRAMES // 2]
    area = float((mean[is_jump][:, None] > mean[~is_jump]).mean())
    claim = 'figure 19: run, jump, run by the 2D error of the periodic model: area under the ROC curve'
    return [[claim, 'separable', None, None, f'{area:.2f}']]


def claim_variance(_quick: bool) -> list[Row]:
    """Section 3.1."""
    shares = []
    for category in TABLE_1_TRIALS:
        poses = [t.poses for t in common.list_trials() if t.clean and t.category == category]
        stacked = centre_poses(np.concatenate(poses)).reshape(-1, 3 * len(CMU15.joints))
        variance = np.linalg.eigvalsh(np.cov(stacked.T))[::-1]
        shares.append(f'{variance[:10].sum() / variance.sum():.1%}')
    claim = 'share of the variance in the first ten base poses of walks, runs and jumps'
    return [[claim, 'over 99 %', ', '.join(shares), None, None]]


CLAIMS = (
    claim_variance,
    claim_flips,
    claim_number_of_base_poses,
    claim_bone_regulariser,
    claim_bone_lengths,
    claim_convergence,
    claim_noisy_starts,
    claim_hidden_limbs,
    claim_disturbances,
    claim_moving_cameras,
    claim_classification,
)


def report_claims(report: Report) -> None:
    rows: list[Row] = []
    for claim in common.show_progress(CLAIMS, 'claims'):
        rows += claim(report.quick)
        report.results['claims'] = rows
        report.save()
    header = ['figure or claim', 'paper', 'Algorithm 1', 'joint solver', 'periodic model']
    report.table(header, rows, page='paper.claims')


if __name__ == '__main__':
    run(__doc__, {'table1': report_table_1, 'targets': report_targets, 'claims': report_claims})
