# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The accuracy of the tracker in several situations; `engine.py` measures its time.

It is measured on the subjects `common.HELD_OUT_SUBJECTS`, on which neither the base poses nor the lifter
were trained. This program trains that lifter if it is missing (half an hour). In sections on the same subject, the
base poses are trained on the other trials of the tested subject.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import common
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from reconstruction import reconstruct_whole, track
from report import Record, Report, Section, group, run

from mocap_ros.config import Config, with_settings
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import MotionKind
from mocap_ros.skeleton import CMU15, estimate_stature

Array = NDArray[np.float64]
CATEGORIES = ('walk', 'run', 'jump')
# Trials of subjects that the models were not trained on, with their categories.
UNSEEN_TRIALS = (
    ('35_02', 'walk'),
    ('35_12', 'walk'),
    ('35_17', 'run'),
    ('35_22', 'run'),
    ('13_11', 'jump'),
    ('13_32', 'jump'),
)
# Trials that are tested with base poses of the same subject.
SAME_SUBJECT_TRIALS = (('35_02', 'walk'), ('35_17', 'run'))
# Trials on which the predicted standard deviations are tested; none of them served to choose their factors.
RELIABILITY_TRIALS = ('35_20', '35_23', 'UW_22', '13_19x', 'UT_01', 'UWW_01', '135_04', '135_08')
# Joints that are hidden in the tests of the standard deviations.
HIDDEN_LIMBS = ((), ('lelbow', 'lwrist'), ('rknee', 'rankle'))
NOISES = (0.0, 0.01, 0.02)  # option `noise` of the protocol
mpl.use('Agg')


def train_models(categories: Iterable[str] = (*CATEGORIES, '')) -> dict[str, BasePoses]:
    return {c or 'all': common.train_base_poses(c, without_subjects=common.HELD_OUT_SUBJECTS) for c in categories}


def make_tracker_config(prior: str, **values: Any) -> Config:
    """Return the default configuration with this prior and with parameters given as `group__field`."""
    return with_settings(Config(), {'solver.prior': prior, **{k.replace('__', '.'): v for k, v in values.items()}})


PRIORS = {'learned': str(common.HELD_OUT_LIFTER), 'pca': 'pca'}


def measure_lags(quick: bool) -> list[dict[str, Any]]:
    """Measure the MPJPE of the tracker and of the whole-sequence solver, with the category unknown and known."""
    rows = []
    trials, headings = (UNSEEN_TRIALS[::2], (45,)) if quick else (UNSEEN_TRIALS, common.HEADINGS_DEG)
    auto = train_models()
    for prior, value in PRIORS.items():
        for trial, category in common.show_progress(trials, f'lag, {prior}'):
            views, known = common.make_views(trial, headings), train_models((category,))
            config = make_tracker_config(value)
            late = [slice(min(v.frames // 2, 30), None) for v in views]
            offline = [reconstruct_whole(v, auto, config) for v in views]
            record: dict[str, Any] = {'trial': f'{trial} {category}', 'prior': prior}
            record['whole'] = mean_error(views, offline)
            for lag in (0.0, 0.1, 0.5) if prior == 'learned' and not quick else (0.0,):
                found = [track(v, auto, make_tracker_config(value, tracker__lag=lag)).joints for v in views]
                record[f'lag {lag:g} s'] = mean_error(views, found)
                if lag == 0:
                    record['whole, after 1 s'] = mean_error(views, offline, late)
                    record['lag 0 s, after 1 s'] = mean_error(views, found, late)
            if not quick:
                whole = [reconstruct_whole(v, known, config) for v in views]
                record['whole, category known'] = mean_error(views, whole)
                live = [track(v, known, config).joints for v in views]
                record['lag 0 s, category known'] = mean_error(views, live)
            rows.append(record)
    return rows


def report_lags(report: Report, quick: bool) -> None:
    rows = measure_lags(quick)
    report.rows('MPJPE of the tracker and of the whole-sequence solver, mm', rows, page='tracker.lags')
    ratios = {p: {c or 'all': compute_ratio(rows, p, c) for c in ('', *CATEGORIES)} for p in PRIORS}
    named = [{'prior': p, **r} for p, r in ratios.items()]
    report.rows('Error at lag 0 / error of the whole-sequence solver', named, page='tracker.ratios')
    as_before = measure_newest_as_version_01(quick)
    report.rows("Newest frame under pca with CMU's wrists, mm", as_before, page='tracker.as_version_01')
    report.add(lag=rows, ratios=ratios, windowed_over_whole=ratios['learned']['all'], as_version_01=as_before)


def measure_newest_as_version_01(quick: bool) -> list[dict[str, Any]]:
    """Measure the newest frame under `pca` on the capture with which version 0.1 was measured."""
    before, headings = {'walk': 26.0, 'run': 24.0, 'jump': 30.0}, (45,) if quick else common.HEADINGS_DEG
    errors: dict[str, list[float]] = {}
    common.choose_capture('cmu')
    models, config = train_models(), make_tracker_config('pca')
    for trial, category in common.show_progress(UNSEEN_TRIALS, 'lag, pca, CMU'):
        views = common.make_views(trial, headings)
        found = [track(v, models, config).joints for v in views]
        errors.setdefault(category, []).append(mean_error(views, found))
    common.choose_capture('motion')
    return [
        {'motion': category, 'version 0.1': before[category], 'now': float(np.mean(found))}
        for category, found in errors.items()
    ]


def compute_ratio(rows: Sequence[Mapping[str, Any]], prior: str, category: str = '') -> float:
    """Return the ratio of the mean error at lag 0 to that of the whole-sequence solver."""
    chosen = [r for r in rows if r['prior'] == prior and r['trial'].endswith(category)]
    return float(np.mean([r['lag 0 s'] for r in chosen]) / np.mean([r['whole'] for r in chosen]))


def mean_error(
    views: Sequence[common.View],
    answers: Sequence[Array],
    frames: Sequence[slice] | None = None,
    key: str = 'mpjpe_mm',
) -> float:
    parts = frames or [slice(None)] * len(views)
    return float(np.mean([compute_error(v, a, p, key) for v, a, p in zip(views, answers, parts, strict=True)]))


def compute_error(view: common.View, joints: Array, frames: slice = slice(None), key: str = 'mpjpe_mm') -> float:
    """Return an error over the frames that have a reconstruction."""
    part = common.View(
        {**view.sequence, **{k: view.sequence[k][frames] for k in ('keypoints', 'timestamps', 'joints3d')}}
    )
    return float(common.compute_errors(part, joints[frames], CMU15.joints)[key])


def report_perspective(report: Report, quick: bool) -> None:
    """Measure the MPJPE of whole sequences near the camera with weak and with true perspective, same subject."""
    rows = []
    headings = (45, 180) if quick else common.HEADINGS_DEG
    cases: list[dict[str, Any]] = [{}, *({'distance': d} for d in (2.0, 3.0, 5.0))]
    cases = cases[:3:2] if quick else [*cases, {'distance': 3.0, 'offset': (0.8, 0.0)}]
    for trial, category in SAME_SUBJECT_TRIALS[:1] if quick else SAME_SUBJECT_TRIALS:
        model = common.train_base_poses(category, only_subjects=(trial[:2],), without_trials=(trial,))
        for options in common.show_progress(cases, 'perspective'):
            views = common.make_views(trial, headings, **options)
            record: dict[str, Any] = {'case': f'{trial} {options or "orthographic"}'}
            for prior, value in PRIORS.items():
                for label, on in (('weak', False), ('perspective', True)):
                    config = make_tracker_config(value, tracker__perspective=on)
                    found = [reconstruct_whole(v, {'m': model}, config) for v in views]
                    record[f'{prior}, {label}'] = mean_error(views, found)
            rows.append(record)
    report.rows('Perspective: whole sequence, same subject, MPJPE, mm', rows, page='tracker.perspective')
    report.add(perspective=rows)


def report_metric(report: Report, quick: bool) -> None:
    """Measure metric errors at 3 m with the true body height given, of whole sequences and of the tracker."""
    rows = []
    for trial, category in SAME_SUBJECT_TRIALS[:1] if quick else SAME_SUBJECT_TRIALS:
        truth = estimate_stature(common.load_capture()[0][trial] / 1e3, CMU15)
        views = common.make_views(trial, (45,) if quick else common.HEADINGS_DEG, distance=3.0)
        given = (
            {'unknown': train_models()}
            if quick
            else {'unknown': train_models(), 'known': train_models((category,))}
        )
        for prior, value in PRIORS.items():
            config = make_tracker_config(value, tracker__body_height=truth)
            for label, models in given.items():
                ways = {'whole': [reconstruct_whole(v, models, config) for v in views]}
                ways['lag 0'] = [track(v, models, config).joints for v in views]
                for way, answers in ways.items():
                    row = {'case': f'{trial}, {way}', 'prior': prior, 'category': label}
                    errors = {k: mean_error(views, answers, key=k) for k in ('metric_mpjpe_mm', 'root_mm')}
                    rows.append({**row, **errors})
    report.rows('Metric errors at 3 m, body height given, subject left out', rows, page='tracker.metric')
    report.add(metric=rows)


def measure_reliability(quick: bool, prior: str, headings: Sequence[float]) -> dict[str, Any]:
    """Measure the share of true errors within the predicted standard deviation, for seen and for hidden joints.

    Every trial is tested without noise and with two levels of noise, with all joints seen and with an arm or a leg
    hidden. The first half second is left out. None of these trials served to choose the factors of the deviations.
    """
    trials = RELIABILITY_TRIALS[::4] if quick else RELIABILITY_TRIALS
    noises = NOISES[::2] if quick else NOISES
    models, config = train_models(), make_tracker_config(prior)
    records: list[dict[str, Any]] = []
    for number, trial in enumerate(common.show_progress(trials, 'reliability')):
        for noise in noises:
            for view in common.make_views(trial, [h + 37 * number for h in headings], frames=100, noise=noise):
                for limb in HIDDEN_LIMBS:
                    found = track(view.hide_joints(limb), models, config)
                    pose, truth = common.align_scale(found.joints, view.truth)
                    wrong = np.linalg.norm(pose - truth, axis=-1)
                    for label, chosen in (('seen', ~found.inferred), ('hidden', found.inferred)):
                        late = chosen & (np.arange(view.frames) >= 15)[:, None]
                        pair = np.stack([found.std[late], wrong[late]])
                        records.append(
                            {'joints': label, 'trial': trial, 'noise': f'noise {noise:g}', 'pair': pair}
                        )
    out: dict[str, Any] = {}
    for (label,), mine in group(records, 'joints').items():
        std, wrong = np.concatenate([r['pair'] for r in mine], axis=1)
        groups = np.array_split(np.argsort(std), 8)
        out[label] = {
            'within': compute_share_within(mine),
            'std mm': [float(std[g].mean() * 1e3) for g in groups],
            'two thirds within mm': [float(np.quantile(wrong[g], 2 / 3) * 1e3) for g in groups],
            'trials': {k: compute_share_within(r) for (k,), r in group(mine, 'trial').items()},
            'noises': {k: compute_share_within(r) for (k,), r in group(mine, 'noise').items()},
        }
    return out


def compute_share_within(records: Sequence[Record]) -> float:
    std, wrong = np.concatenate([r['pair'] for r in records], axis=1)
    return float((wrong <= std).mean())


def draw_reliability(found: Mapping[str, Any]) -> Figure:
    figure, axes = plt.subplots(figsize=(4.5, 4), layout='constrained')
    for label, marker in (('seen', 'o'), ('hidden', 's')):
        x, y = found[label]['std mm'], found[label]['two thirds within mm']
        axes.plot(x, y, marker=marker, label=f'{label} joints')
    most = max(max(found[k]['two thirds within mm']) for k in found) * 1.05
    axes.plot([0, most], [0, most], color='0.6', linewidth=1, label='as predicted')
    axes.set(xlabel='predicted standard deviation, mm', ylabel='two thirds of the true errors are below, mm')
    axes.legend(frameon=False)
    return figure


def report_switching(report: Report, _quick: bool) -> None:
    """Track a walk, a jump and a walk in sequence, and measure when the live classification changes."""
    motion, _ = common.load_capture()
    parts = [motion['35_29'][:120], motion['UJ_01'][:150], motion['35_29'][:120]]
    parts = [p - p.mean(axis=(0, 1)) for p in parts]
    (view,) = common.make_views(np.concatenate(parts), (60,), frames=390)
    found = track(view, train_models(), make_tracker_config(PRIORS['learned']))
    periodic = np.array([k is MotionKind.PERIODIC for k in found.kinds])
    seams = np.cumsum([len(p) for p in parts])[:-1]
    live = {
        'changes': int(np.abs(np.diff(periodic.astype(int))).sum()),
        'not periodic after s': float(np.argmin(periodic[seams[0] :]) / 30),
        'periodic again after s': float(np.argmax(periodic[seams[1] :]) / 30),
    }
    report.rows('Live classification of a walk, a jump and a walk', [live], page='tracker.switching')
    report.add(switching=live)


def report_reliability(report: Report, quick: bool) -> None:
    found = {'learned': measure_reliability(quick, PRIORS['learned'], (20,) if quick else (20, 200))}
    if not quick:
        found['pca'] = measure_reliability(quick, 'pca', (20,))
        report.picture(draw_reliability(found['learned']), 'docs/img/tracker/reliability.png')
    each = [(p, label, found[p][label]) for p in found for label in ('seen', 'hidden')]
    rows = [{'prior': p, 'joints': j, 'within': f['within'], **f['noises'], **f['trials']} for p, j, f in each]
    report.rows('Share of the errors within the predicted standard deviation', rows, page='tracker.reliability')
    bins = [
        [p, j, *(f'{a:.0f} / {b:.0f}' for a, b in zip(f['std mm'], f['two thirds within mm'], strict=True))]
        for p, j, f in each
    ]
    report.text('In eight groups by size: predicted standard deviation / two thirds of the errors are below, mm')
    report.table(['prior', 'joints', *(f'{i + 1}' for i in range(8))], bins)
    report.add(reliability=found)


SECTIONS: Mapping[str, Section] = {
    'lags': report_lags,
    'perspective': report_perspective,
    'metric': report_metric,
    'reliability': report_reliability,
    'switching': report_switching,
}


if __name__ == '__main__':
    common.choose_capture('motion')
    run(__doc__, 'Tracker', SECTIONS)
