# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tracker and lifter: what the newest frame costs, whether its deviations are right, and what the lifter brings.

It is measured on subjects on which neither the base poses nor the lifter were trained. Sections of `--only`:

    lags         MPJPE of the newest frame, of frames that are answered later, and of whole sequences
    reliability  share of true errors within the predicted standard deviation, for seen and for hidden joints
    lifter       the network alone, the joint solver with base poses alone, and both, clean and with a bad detector
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray
from report import Report, group, run

from mocap_ros.config import Config, SolverConfig
from mocap_ros.formats.mocap.trials import Trial
from mocap_ros.models.lifter import scale_to_metres
from mocap_ros.models.model_file import load_lifter
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.joint.solver import solve_hypotheses

Array = NDArray[np.float64]

LAG_TRIALS = {
    '35_02': 'walk',
    '35_12': 'walk',
    '35_17': 'run',
    '35_22': 'run',
    '13_11': 'jump',
    '13_32': 'jump',
}
LAGS_S = (0.0, 0.1, 0.5)
# Trials of which none served to choose the factors of the deviations.
RELIABILITY_TRIALS = ('35_20', '35_23', 'UW_22', '13_19x', 'UT_01', 'UWW_01', '135_04', '135_08')
HIDDEN_LIMBS = ((), ('lelbow', 'lwrist'), ('rknee', 'rankle'))
NOISES = (0.0, 0.01, 0.02)  # option `noise` of the protocol
START_FRAMES = 15  # that do not count for deviations

# Rows of the table: which trials belong to the row, and the target of its MPJPE in mm.
LIFTER_ROWS: dict[str, tuple[Callable[[Trial], bool], float]] = {
    '35 walk': (lambda t: t.subject == '35' and t.category == 'walk', 16),
    '35 run': (lambda t: t.subject == '35' and t.category == 'run', 22),
    '13 jump': (lambda t: t.subject == '13' and t.category == 'jump', 40),
    '05 dance': (lambda t: t.subject == '05' and t.category == 'dance', 65),
    '135 martial arts': (lambda t: t.subject == '135', 60),
    'U* gestures': (lambda t: t.subject.startswith('U') and t.category == 'gesture', 34),
}
CONDITIONS: dict[str, dict[str, Any]] = {'clean': {}, 'noisy': {'noise': 0.02, 'missing': 0.1}}
LIFTER_FRAMES = 120


def report_lags(report: Report) -> None:
    model, parameters = common.provide_held_out()
    trials = list(LAG_TRIALS.items())[:: 2 if report.quick else 1]
    rows: list[dict[str, Any]] = []
    for trial, category in common.show_progress(trials, 'lags'):
        views = common.make_views(trial, (45,) if report.quick else common.HEADINGS_DEG)
        found = {'whole': [common.reconstruct_whole(v, model, parameters) for v in views]}
        for lag in LAGS_S:
            found[f'lag {lag:g} s'] = [
                common.track(v, model, {**parameters, 'tracker.lag': lag}).joints for v in views
            ]
        errors = {way: common.mean_error(common.compute_all_errors(views, f)) for way, f in found.items()}
        ratio = errors['lag 0 s'] / errors['whole']
        rows.append({'trial': f'{trial} {category}', **errors, 'lag 0 s / whole': ratio})
    report.rows('Newest frame and whole sequences, clean points: MPJPE, mm', rows, 'tracker.lags')


def report_reliability(report: Report) -> None:
    model, parameters = common.provide_held_out()
    trials, noises = RELIABILITY_TRIALS[:: 4 if report.quick else 1], NOISES[:: 2 if report.quick else 1]
    records: list[dict[str, Any]] = []
    for number, trial in enumerate(common.show_progress(trials, 'reliability')):
        for noise in noises:
            for view in common.make_views(
                trial, [h + 37 * number for h in ((20,) if report.quick else (20, 200))], frames=100, noise=noise
            ):
                for limb in HIDDEN_LIMBS:
                    found = common.track(view.hide_joints(limb), model, parameters)
                    core = slice(len(CMU15.joints))
                    pose, truth = common.align_scale(found.joints[:, core], view.true_poses)
                    wrong, std, inferred = (
                        np.linalg.norm(pose - truth, axis=-1),
                        found.std[:, core],
                        found.inferred[:, core],
                    )
                    for label, chosen in (('seen', ~inferred), ('hidden', inferred)):
                        late = chosen & (np.arange(view.frames) >= START_FRAMES)[:, None]
                        pair = np.stack([std[late], wrong[late]])
                        records.append({'joints': label, 'noise': f'noise {noise:g}', 'pair': pair})

    def compute_share(some: Sequence[Any]) -> str:
        std, wrong = np.concatenate([r['pair'] for r in some], axis=1)
        return f'{(wrong <= std).mean():.2f}'

    rows = []
    for (label,), mine in group(records, 'joints').items():
        by_noise = {noise: compute_share(some) for (noise,), some in group(mine, 'noise').items()}
        rows.append({'joints': label, 'all': compute_share(mine), **by_noise})
    report.rows('Share of the errors within the predicted standard deviation', rows, 'tracker.reliability')


def report_lifter(report: Report) -> None:
    common.choose_capture('motion')
    lifter, height = load_lifter(common.HELD_OUT_LIFTER), Config().tracker.body_height
    poses = common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)
    rows = []
    for row, (is_chosen, target) in common.show_progress(
        list(LIFTER_ROWS.items())[: 2 if report.quick else 6], 'rows'
    ):
        names = [t.name for t in common.list_trials() if t.clean and is_chosen(t)]
        names = names[:: max(1, len(names) // (1 if report.quick else 3))]
        record, both = {'motion': row}, []
        for condition, options in CONDITIONS.items():
            headings = common.HEADINGS_DEG[::2]
            views = [v for n in names for v in common.make_views(n, headings, frames=LIFTER_FRAMES, **options)]
            windows = [v.window for v in views]
            lifted = [lifter.lift_sequence(w.points, w.weight, w.times, w.focal).select_core() for w in windows]
            given = [replace(w, lifted=out) for w, out in zip(windows, lifted, strict=True)]
            found = {
                'network': [scale_to_metres(o, w.times, height) for o, w in zip(lifted, windows, strict=True)],
                'factorisation': solve_hypotheses(windows, poses, SolverConfig()),
                'both': solve_hypotheses(given, poses, SolverConfig()),
            }
            errors = {m: common.mean_error(common.compute_all_errors(views, f)) for m, f in found.items()}
            record |= {f'{m}, {condition}': f'{e:.1f}' for m, e in errors.items()}
            both.append(errors['both'])
        rows.append({**record, 'target, clean': f'{target:g}', 'noisy / clean': f'{both[1] / both[0]:.2f}'})
    report.rows('MPJPE, mm', rows, 'lifter.solver')


if __name__ == '__main__':
    run(__doc__, {'lags': report_lags, 'reliability': report_reliability, 'lifter': report_lifter})
