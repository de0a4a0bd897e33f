# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors with points as real detectors give them, on people that no model was trained on.

Motion capture of `data/motion` is seen through the protocol's models of detectors (`DETECTORS` of protocol.py) and
with clean points, from headings all around the person, by an orthographic camera and by a perspective one that is
3 m away. 15 joints; poses are compared about their centres, with one scale for a sequence. The base poses and the
lifter were not trained on the tested people; the program trains them if they are missing. Sections of `--only`:

    whole       whole sequences
    live        the tracker's newest frame
    swaps       swaps of left and right undone, and joints exchanged wrongly, in trials of 10 s and more
    oracles     the same errors without some of the detectors' errors: what is left to gain
    fixed       whole sequences by the defaults, and by the model that suits a person and a motion best
    own         base poses of the very person's other trials: given to the defaults, given alone, not given
    recordings  the recorded detections of `data/detections`, 12 joints of the limbs
    ghosts      people published who are not there
    extremities where heads and feet point, and how far off toes, hands and faces are
    pictures    median and worst sequence of all detectors, into docs/img/detectors

`--persons training` tests other people, for tuning. `--against FILE` compares with the `--json` of an earlier run,
view by view. `--quick` takes four minutes, all sections an hour; `--only`, `--detectors` and `--seeds` split it.
No model saw the person of the recordings, so `--models shipped` tests there what ships.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import common
import numpy as np
import yaml
from experiments.detector_errors import POSES, compute_errors, summarise
from experiments.detector_extremities import (
    compute_extremity_errors,
    reconstruct_body,
    summarise_extremities,
)
from experiments.detector_ghosts import measure_ghosts
from experiments.detector_pictures import draw_cases
from experiments.detector_swaps import KINDS, MIN_SWAP_FRAMES, count_swaps, find_exchanged
from experiments.detector_views import (
    CLEAN,
    DETECTORS,
    ORACLES,
    DetectedView,
    ViewOptions,
    choose_trials,
    list_views,
    load_motion,
    make_view,
)
from experiments.fixed_models import DEFAULTS, FIXED, WORSE, load_fixed_models, summarise_fixed
from experiments.own_base_poses import ALONE, NOT_GIVEN, OWN, summarise_own, train_own_base_poses
from reconstruction import WAYS, Models, reconstruct
from report import Records, Report, cross, group, run

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, with_values
from mocap_ros.models.base_poses import ALL_MOTIONS
from mocap_ros.models.model_file import AUTO, LEARNED, load_base_pose_models, load_prior_lifter
from mocap_ros.skeleton import CMU15

SECTIONS = (*WAYS, 'swaps', 'oracles', 'fixed', 'own', 'recordings', 'ghosts', 'extremities', 'pictures')
CALM_MOTIONS = ('walk', 'gesture', 'expression')  # categories for which targets of directions are set
QUICK_SECTIONS = (*WAYS, 'swaps', 'recordings')
QUICK_FRAMES = 150  # frames, 5 s
QUICK_TRIALS = 5  # of the fixed models, of which there are eight
MAX_FRAMES = 600  # frames, 20 s
MIN_LONG_FRAMES = 300  # frames, 10 s; a filter of swaps that goes wrong may take a while to do so
SEEDS = (0, 1, 2)
TRIALS_PER_MOTION = 4  # trials of each held-out person and kind of motion; one with `--quick`
PICTURES = common.ROOT / 'docs' / 'img' / 'detectors'
COMPARED = {'mpjpe_mm': 1.0, 'pa_mpjpe_mm': 1.0, 'accel_mm_s2': 1e3}  # errors, with their divisors, of `--against`
# What the tables of the pages call detectors and ways.
PAGE_NAMES = {d: f'{n}-like' for d, n in zip(DETECTORS[1:], ('OpenPose', 'MediaPipe', 'MoveNet'), strict=True)}
PAGE_NAMES |= {'detector': 'points', 'category': 'motion', 'whole': 'whole sequence'}


@dataclass(frozen=True, eq=False)
class Measurement:
    """What is measured.

    Attributes:
        models: base poses by name.
        config: parameters, with the lifter.
        quick: whether to run the short version.
        persons: `held-out` or `training`.
        detectors: names of the detectors.
        seeds: seeds of the detectors' errors.
        ways: `whole` and `live`, or one of them.
        against: results of an earlier run to compare with, or None.
    """

    models: Models
    config: Config
    quick: bool
    persons: str
    detectors: Sequence[str]
    seeds: Sequence[int]
    ways: Sequence[str]
    against: Path | None

    @property
    def disturbed(self) -> list[str]:
        """The detectors that make errors."""
        return [d for d in self.detectors if d != CLEAN]

    @property
    def frames(self) -> int:
        """Largest number of frames of a view."""
        return QUICK_FRAMES if self.quick else MAX_FRAMES

    @property
    def trials_per_motion(self) -> int:
        return 1 if self.quick else TRIALS_PER_MOTION


def measure_views(
    options: Sequence[ViewOptions], ways: Sequence[str], measure: Callable[[str, DetectedView], Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return one record for each view and way: how the trial is seen, and what is measured of it."""
    records = []
    for chosen in common.show_progress(options, ' and '.join(ways)):
        seen = make_view(chosen)
        about = {**asdict(chosen), 'category': chosen.category}
        records += [{**about, 'way': way, **measure(way, seen)} for way in ways]
    return records


def measure_errors(options: Sequence[ViewOptions], ways: Sequence[str], run: Measurement) -> Records:
    """Return the errors of each view and way."""
    return measure_views(
        options, ways, lambda way, s: compute_errors(s, reconstruct(way, s.view, run.models, run.config))
    )


def spread_of_seeds(records: Records) -> str:
    """Return the standard deviation of the mean errors of the seeds, behind a ±; empty for a single seed."""
    means = [summarise(mine)['mpjpe'] for mine in group(records, 'seed').values()]
    return f' ± {statistics.stdev(means):.1f}' if len(means) > 1 else ''


def show_errors(report: Report, records: Records, key: str) -> None:
    """Show the mean errors of each value of a key, detector and way."""
    keys = list(dict.fromkeys((key, 'detector', 'way')))
    rows = [
        {**dict(zip(keys, values, strict=True)), 'views': len(mine), **summarise(mine)}
        for values, mine in group(records, *keys).items()
    ]
    report.rows(f'By {key}: mm; m/s^2; ratio of output to true RMS acceleration; delay of limbs, frames', rows)


def format_summary(records: Records) -> str:
    s = summarise(records)
    return (
        f'{s["mpjpe"]:.1f}{spread_of_seeds(records)} / {s["pa"]:.1f} / {s["acceleration"]:.1f} / {s["ratio"]:.1f}'
    )


def format_pose_errors(records: Records) -> str:
    count, mpjpe, pa = np.sum([r['sums'] for r in records], axis=0)
    return f'{mpjpe / count:.0f} / {pa / count:.0f}'


def show_tables_of_errors(report: Report, records: Records) -> None:
    """Show the tables of the page: all views, and whole sequences by motion and by true pose."""
    report.text('Behind ± is the standard deviation of the means of the seeds, which also differ in the headings.')
    report.table(*cross(records, 'detector', 'way', format_summary, PAGE_NAMES), page='detectors.points')
    for (way,), mine in group(records, 'way').items():
        pages = ('detectors.motions', 'detectors.poses') if way == WAYS[0] else ('', '')
        motions = cross(mine, 'category', 'detector', lambda r: f'{summarise(r)["mpjpe"]:.0f}', PAGE_NAMES)
        report.table(*motions, f'{PAGE_NAMES.get(way, way)}, by motion: MPJPE, mm', page=pages[0])
        poses = [{'pose': p, **r, 'sums': r['poses'][p]} for p in POSES for r in mine if p in r['poses']]
        by_pose = cross(poses, 'pose', 'detector', format_pose_errors, PAGE_NAMES)
        report.table(*by_pose, f'{PAGE_NAMES.get(way, way)}, by true pose: MPJPE / PA, mm', page=pages[1])


def show_comparison(report: Report, records: Records, before: Records) -> None:
    """Show the mean changes since an earlier run over the views of both, with their standard errors."""
    keys = ('trial', 'detector', 'seed', 'heading', 'camera', 'frames', 'oracle', 'way')
    earlier = group(before, *keys)
    rows = []
    for (detector, way), mine in group(records, 'detector', 'way').items():
        pairs = [(r, earlier[name][-1]) for r in mine if (name := tuple(r[k] for k in keys)) in earlier]
        row: list[object] = [detector, way, len(pairs)]
        for key, divisor in COMPARED.items():
            change = np.array([r[key] - b[key] for r, b in pairs]) / divisor
            row.append(f'{change.mean():+.2f} ± {change.std() / np.sqrt(len(change)):.2f}')
        rows += [row] if pairs else []
    header = ['detector', 'way', 'views', 'MPJPE, mm', 'PA, mm', 'accel., m/s^2']
    report.table(header, rows, 'Change since the earlier run, with its standard error')


def describe_swaps(records: Records) -> list[str]:
    """Return the shares of wrong frames, and what is undone of each kind of swap."""
    frames = sum(r['frames'] for r in records)
    longest, trial = max((r['longest wrong'], r['trial']) for r in records)
    cells = [f'{100 * sum(r[k] for r in records) / frames:.2f} %' for k in ('wrong', 'wrong without swap')]
    cells.append(f'{longest} ({trial})')
    for kind in KINDS:
        n = {k: sum(r[kind][k] for r in records) for k in records[0][kind]}
        share = f'{100 * n["undone"] / n["frames"]:.0f} %' if n['frames'] else '-'
        single = f'{n["single undone"]} of {n["single"]}'
        cells.append(f'{share} of {n["frames"]} frames, {n["swaps"]} swaps; {single}')
    return cells


def show_swaps(report: Report, records: Records) -> None:
    groups = group(records, 'detector', 'way')
    rows = [[*names, sum(r['frames'] for r in mine), *describe_swaps(mine)] for names, mine in groups.items()]
    report.table(
        ['detector', 'way', 'frames', 'wrong', 'where none is', 'longest wrong, frames', *KINDS],
        rows,
        f'Swaps: undone of those of {MIN_SWAP_FRAMES} frames and more; of single frames',
        'A frame is wrong if a joint of the limbs is exchanged that the detector did not swap.',
    )
    kept = [
        [PAGE_NAMES[d], PAGE_NAMES.get(w, w), cells[0], *(c.partition(',')[0] for c in cells[3:])]
        for (d, w), mine in groups.items()
        for cells in [describe_swaps(mine)]
    ]
    report.keep('detectors.swaps', ['points', 'result', 'wrong', *KINDS], kept)


def show_oracles(report: Report, records: Records) -> None:
    """Show the errors under each oracle beside those with all of the detector's errors."""
    names = {**PAGE_NAMES, '': 'all errors', 'true 2D points': "true points, with the detector's scores and gaps"}
    for (way,), mine in group(records, 'way').items():
        table = cross(mine, 'detector', 'oracle', lambda r: '{mpjpe:.1f} / {pa:.1f}'.format(**summarise(r)), names)
        title = f'Oracles, {PAGE_NAMES.get(way, way)}: MPJPE / PA, mm'
        report.table(*table, title, page='detectors.oracles' if mine[0]['way'] == records[0]['way'] else '')


def measure_recordings(run: Measurement) -> Records:
    """Return the errors on the recorded detections, and those of MediaPipe's own 3D joints."""
    records = []
    for detector, camera in product(common.RECORDED_DETECTORS, common.CAMERAS):
        view = common.load_recording(detector, camera)
        found = [reconstruct(way, view, run.models, run.config) for way in run.ways]
        scores = common.compute_all_errors([view] * len(found), found, 'limbs')
        by_way: dict[str, Mapping[str, Any]] = dict(zip(run.ways, scores, strict=True))
        if own := common.compute_errors_of_detector(view):
            by_way["the detector's own 3D"] = own
        records += [{'detector': detector, 'camera': camera, 'way': w, **s} for w, s in by_way.items()]
    return records


def show_recordings(report: Report, records: Records) -> None:
    rows = []
    for names, mine in group(records, 'detector', 'way').items():
        cells = [[r[k] for k in ('mpjpe_mm', 'pa_mpjpe_mm')] for r in mine]
        cells.append(np.mean(cells, axis=0).tolist())
        acceleration = f'{common.mean_error(mine, "accel_mm_s2") / 1e3:.1f}'
        failed = sum(int(r['failed_frames']) for r in mine)
        rows.append([*names, *('{:.1f} / {:.1f}'.format(*c) for c in cells), acceleration, failed])
    report.table(
        ['detector', 'result', *(f'camera {c}' for c in common.CAMERAS), 'mean', 'accel.', 'failed'],
        rows,
        'Recorded detections, 12 joints of the limbs: MPJPE / PA, mm; acceleration error, m/s^2',
        page='detectors.recordings',
    )


def show_ghosts(report: Report, found: Mapping[str, Mapping[str, Mapping[str, int]]]) -> None:
    first = next(iter(found.values()))['with ids']
    rows = [
        [detector, label, *n.values()]
        for detector, counts in found.items()
        for label, n in counts.items()
        if label != 'crossing'
    ]
    title = 'Ghosts: person-frames published of people who are not there'
    report.table(['detector', 'people', *first], rows, title, page='detectors.ghosts')
    for detector, counts in found.items():
        report.text('{}: {kept} of {pairs} crossing pairs keep their ids.'.format(detector, **counts['crossing']))


def show_extremities(report: Report, records: Records) -> None:
    """Show the errors of face, feet and hands, of walking and gestures and of all motions."""
    calm = [r for r in records if r['category'] in CALM_MOTIONS]
    rows = [
        [motions, PAGE_NAMES.get(detector, detector), PAGE_NAMES.get(way, way), *summarise_extremities(mine)]
        for motions, some in (('walking, gestures', calm), ('all', records))
        for (detector, way), mine in group(some, 'detector', 'way').items()
    ]
    report.table(
        ['motions', 'points', 'result', 'head', 'feet', 'toes / hands / face', 'alone', 'tremble'],
        rows,
        'Face, feet and hands: degrees; mm; mm relative to ankles, wrists and head; degrees a frame',
        page='detectors.extremities',
    )


def load_models(shipped: bool, config: Config) -> tuple[Models, Config]:
    """Return base poses by name and the configuration with a lifter; where it names models, it has precedence."""
    common.choose_capture('motion')
    models: Models = {ALL_MOTIONS: common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)}
    if shipped or config.tracker.model != AUTO:
        models = load_base_pose_models(ALL_MOTIONS if config.tracker.model == AUTO else config.tracker.model)
    if not shipped and config.solver.prior == LEARNED:
        config = with_values(config, {'solver.prior': str(common.HELD_OUT_LIFTER)})
    return models, config


def describe_models(models: Models, config: Config) -> str:
    """Say which models these are, on what they were trained, and on whom not."""
    lifter = load_prior_lifter(config.solver.prior, CMU15)
    about = {} if lifter is None else lifter.provenance
    data, without = about.get('data', 'unknown data'), about.get('without_subjects') or 'nobody'
    lines = [f'Lifter `{config.solver.prior}`: {data}, without {without}.']
    for name, model in models.items():
        data = model.provenance.get('data', 'trained by this program')
        lines.append(f'Base poses `{name}`: {data}, {model.provenance.get("poses")} poses.')
    return '\n'.join(lines)


def parse_values(assignments: Sequence[str]) -> dict[str, object]:
    """Return the values of parameters by name, of texts `group.field=value`."""
    parts = (a.partition('=') for a in assignments)
    return {name: yaml.safe_load(text) for name, _, text in parts}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--only', nargs='+', choices=SECTIONS, help='sections to run')
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--models', choices=('held-out', 'shipped'), default='held-out')
    parser.add_argument('--detectors', nargs='+', choices=DETECTORS, default=list(DETECTORS))
    parser.add_argument('--seeds', nargs='+', type=int, metavar='N', help='seeds of the errors, default 0 1 2')
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='set a parameter, such as solver.prior=pca',
    )
    parser.add_argument('--against', type=Path, metavar='FILE', help='compare with the results of an earlier run')


def choose_measurement(args: argparse.Namespace) -> Measurement:
    """Return what is measured, by the command line."""
    models, config = load_models(args.models == 'shipped', with_values(Config(), parse_values(args.set)))
    sections = args.only or (QUICK_SECTIONS if args.quick else SECTIONS)
    return Measurement(
        models,
        config,
        args.quick,
        args.persons,
        args.detectors,
        args.seeds or (SEEDS[:2] if args.quick else SEEDS),
        [w for w in WAYS if w in sections] or list(WAYS),
        args.against,
    )


def run_errors(run: Measurement, report: Report) -> Records:
    trials = choose_trials(run.persons, run.trials_per_motion)
    errors = measure_errors(list_views(trials, run.detectors, run.frames, run.seeds), run.ways, run)
    for key in ('detector', 'category', 'camera'):
        show_errors(report, errors, key)
    show_tables_of_errors(report, errors)
    if run.against:
        show_comparison(report, errors, json.loads(run.against.read_text(encoding='utf-8'))['errors'])
    return errors


def list_long_views(run: Measurement, detectors: Sequence[str], seeds: Sequence[int]) -> list[ViewOptions]:
    """Return views of trials of `MIN_LONG_FRAMES` and more."""
    trials = choose_trials(run.persons, run.trials_per_motion, MIN_LONG_FRAMES)
    return list_views(trials, detectors, max(run.frames, MIN_LONG_FRAMES), seeds)


def list_short_views(run: Measurement, detectors: Sequence[str], oracle: str = '') -> list[ViewOptions]:
    """Return one short view of a trial of each motion."""
    return list_views(choose_trials(run.persons, 1), detectors, QUICK_FRAMES, run.seeds[:1], oracle)


def run_swaps(run: Measurement, report: Report) -> Records:
    def count(way: str, seen: DetectedView) -> Mapping[str, Any]:
        return count_swaps(seen.is_swapped, *find_exchanged(way, seen, run.models, run.config))

    swaps = measure_views(list_long_views(run, run.disturbed, run.seeds), run.ways, count)
    show_swaps(report, swaps)
    return swaps


def run_oracles(run: Measurement, report: Report) -> Records:
    options = [v for o in ('', *ORACLES) for v in list_short_views(run, run.disturbed, o)]
    errors = measure_errors(options, run.ways, run)
    show_oracles(report, errors)
    return errors


def run_fixed(run: Measurement, report: Report) -> Records:
    trials = choose_trials(run.persons, 1 if run.quick else 2)[: QUICK_TRIALS if run.quick else None]
    options = list_views(trials, run.detectors, QUICK_FRAMES, run.seeds[:1])
    fixed = load_fixed_models()
    records: list[dict[str, Any]] = []
    runs = {DEFAULTS: run}
    for prior, name in FIXED:
        config = run.config if prior == LEARNED else with_values(run.config, {'solver.prior': prior})
        runs[f'{prior}, {name}'] = replace(run, models={name: fixed[name]}, config=config)
    for model, chosen in runs.items():
        errors = measure_errors(options, WAYS[:1], chosen)
        persons = [load_motion()[2][o.trial]['subject'] for o in options]
        records += [{**r, 'model': model, 'person': p} for r, p in zip(errors, persons, strict=True)]
    rows = [[PAGE_NAMES.get(str(detector), detector), *cells] for detector, *cells in summarise_fixed(records)]
    above = f'groups above {WORSE}'
    report.table(
        ['points', 'groups', 'defaults', 'best fixed model of each group', 'ratio', above, 'worst group'],
        rows,
        'Defaults against the best of eight models of each person and motion: MPJPE, mm; mean ratio',
        page='detectors.fixed',
    )
    return [{k: r[k] for k in ('trial', 'detector', 'model', 'mpjpe_mm')} for r in records]


def run_own(run: Measurement, report: Report) -> Records:
    options = list_short_views(run, run.detectors)
    by_trial = {o.trial: train_own_base_poses(o.trial) for o in options}
    alone = with_values(run.config, {'solver.prior': 'pca'})
    records: list[dict[str, Any]] = []
    for given, config in ((OWN, run.config), (ALONE, alone), (NOT_GIVEN, run.config)):
        for chosen in options:
            if own := by_trial[chosen.trial]:
                models = run.models if given == NOT_GIVEN else {'own': own}
                some = measure_errors([chosen], run.ways, replace(run, models=models, config=config))
                records += [
                    {**asdict(chosen), **{k: r[k] for k in ('way', 'mpjpe_mm')}, 'given': given} for r in some
                ]
    title = 'Base poses of the very person: MPJPE, mm; the ratio is the geometric mean over the views'
    header = ['detector', 'way', 'views', OWN, ALONE, NOT_GIVEN, 'own / pca']
    report.table(header, summarise_own(records), title, page='detectors.own')
    return records


def run_recordings(run: Measurement, report: Report) -> Records:
    errors = measure_recordings(run)
    show_recordings(report, errors)
    return errors


def run_ghosts(run: Measurement, report: Report) -> dict[str, Any]:
    found = {}
    for detector in run.detectors:
        views = [make_view(v) for v in list_long_views(run, [detector], run.seeds[:1])]
        found[detector] = measure_ghosts(views, run.models, run.config)
    show_ghosts(report, found)
    return found


def run_extremities(run: Measurement, report: Report) -> Records:
    def measure(way: str, seen: DetectedView) -> Mapping[str, Any]:
        return compute_extremity_errors(seen, reconstruct_body(way, seen, run.models, run.config))

    records = measure_views(list_short_views(run, run.detectors), run.ways, measure)
    show_extremities(report, records)
    return records


def run_pictures(run: Measurement, report: Report) -> None:
    options = list_short_views(run, run.disturbed)
    draw_cases(measure_errors(options, run.ways[:1], run), options, run.models, run.config, PICTURES)
    report.pictures += [f.relative_to(common.ROOT).as_posix() for f in sorted(PICTURES.glob('*.png'))]
    report.text(f'Pictures: {PICTURES}')


def measure(args: argparse.Namespace, report: Report) -> None:
    compile_kernels()
    chosen = choose_measurement(args)
    about = describe_models(chosen.models, chosen.config)
    report.text(f'{args.persons} persons', about)
    report.add(models=about)
    wanted = args.only or (QUICK_SECTIONS if args.quick else SECTIONS)
    parts = {'errors' if s in WAYS else s: None for s in wanted}
    for name in parts:
        report.add(**{name: RUNS[name](chosen, report)})


RUNS: Mapping[str, Callable[[Measurement, Report], Any]] = {
    'errors': run_errors,
    'swaps': run_swaps,
    'oracles': run_oracles,
    'fixed': run_fixed,
    'own': run_own,
    'recordings': run_recordings,
    'ghosts': run_ghosts,
    'extremities': run_extremities,
    'pictures': run_pictures,
}

if __name__ == '__main__':
    run(__doc__, 'Detectors', measure, add_options, one_core=False)
