"""Errors with points as real detectors give them, on people that no model was trained on.

Motion capture of `data/motion` is seen through the protocol's models of detectors (`DETECTORS` of protocol.py) and
with clean points, from headings all around the person, by an orthographic camera and by a perspective one that is
3 m away. 15 joints; poses are compared about their centres, with one scale for a sequence. The base poses and the
lifter were not trained on the tested people; the program trains them if they are missing. Sections of `--only`:

    whole       whole sequences
    live        the tracker's newest frame
    swaps       swaps of left and right undone, and joints exchanged wrongly, in trials of 10 s and more
    oracles     the same errors without some of the detectors' errors: what is left to gain
    own         base poses of the very person's other trials: given to the defaults, given alone, not given
    recordings  the recorded detections of `data/detections`, 12 joints of the limbs
    ghosts      people published who are not there
    pictures    best, median and worst sequence of all detectors, into docs/img/detectors

`--persons training` tests other people, for tuning. `--against FILE` compares with the `--json` of an earlier run,
view by view. `--quick` takes four minutes, all sections an hour; `--only`, `--detectors` and `--seeds` split it.
No model saw the person of the recordings, so `--models shipped` tests there what ships.
"""

from __future__ import annotations

import common

# isort: split
import argparse
import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from common import View
from experiments.detector_errors import POSES, compute_errors, reconstruct, summarise
from experiments.detector_ghosts import measure_ghosts
from experiments.detector_pictures import draw_cases
from experiments.detector_swaps import KINDS, MIN_SWAP_FRAMES, count_swaps, find_exchanged
from experiments.detector_views import (
    CLEAN,
    DETECTORS,
    ORACLES,
    ViewOptions,
    choose_trials,
    list_views,
    make_view,
)
from experiments.own_base_poses import ALONE, NOT_GIVEN, OWN, measure_own_base_poses, summarise_own

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, with_values
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import AUTO, LEARNED, load_base_pose_models, load_prior_lifter
from mocap_ros.skeleton import CMU15

WAYS = ('whole', 'live')
SECTIONS = (*WAYS, 'swaps', 'oracles', 'own', 'recordings', 'ghosts', 'pictures')
QUICK_SECTIONS = (*WAYS, 'swaps', 'recordings')
QUICK_FRAMES = 150  # frames, 5 s
MAX_FRAMES = 600  # frames, 20 s
MIN_LONG_FRAMES = 300  # frames, 10 s; a filter of swaps that goes wrong may take a while to do so
SEEDS = (0, 1, 2)
TRIALS_PER_MOTION = 4  # trials of each held-out person and kind of motion; one with `--quick`
PICTURES = common.ROOT / 'docs' / 'img' / 'detectors'
CAMERAS = (1, 2, 3)  # cameras of the recorded detections
RECORDED_DETECTORS = ('openpose', 'mediapipe')
COMPARED = {'mpjpe_mm': 1.0, 'pa_mpjpe_mm': 1.0, 'accel_mm_s2': 1e3}  # errors, with their divisors, of `--against`
ERROR_NAMES = ('MPJPE', 'PA', 'accel.', 'ratio', 'failed')

Models = Mapping[str, BasePoses]
Records = list[dict[str, Any]]


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


def measure_errors(options: Sequence[ViewOptions], ways: Sequence[str], run: Measurement) -> Records:
    """Return one record for each way and view."""
    records = []
    for chosen in common.show_progress(options, ' and '.join(ways)):
        seen = make_view(chosen)
        for way in ways:
            errors = compute_errors(seen, reconstruct(way, seen.view, run.models, run.config))
            records.append({**asdict(chosen), 'category': chosen.category, 'way': way, **errors})
    return records


def select(records: Records, **values: object) -> Records:
    """Return the records with these values."""
    return [r for r in records if all(r[k] == v for k, v in values.items())]


def list_values(records: Records, key: str) -> list[str]:
    """Return the values of a key, in the order of the records."""
    return list(dict.fromkeys(r[key] for r in records))


def print_errors(records: Records, key: str) -> None:
    """Print the mean errors, one row for each value of a key and each detector, columns whole and live."""
    ways = list_values(records, 'way')
    keys = list(dict.fromkeys((key, 'detector')))
    rows = []
    for values in dict.fromkeys(tuple(r[k] for k in keys) for r in records):
        mine = select(records, **dict(zip(keys, values, strict=True)))
        row: list[object] = [*values, len(select(mine, way=ways[0]))]
        for way in ways:
            of_way = select(mine, way=way)
            s = summarise(of_way)
            seeds = [summarise(select(of_way, seed=n))['mpjpe'] for n in {r['seed'] for r in of_way}]
            spread = f' ± {statistics.stdev(seeds):.1f}' if key == 'detector' and len(seeds) > 1 else ''
            row += [f'{s["mpjpe"]:.1f}{spread}', *(f'{s[k]:.1f}' for k in ('pa', 'acceleration'))]
            row += [f'{s["ratio"]:.2f}', int(s['failed'])]
        rows.append(row)
    print(f'\n## By {key}: mm; accelerations m/s^2; ratio of output to true RMS acceleration\n')
    if len({r['seed'] for r in records}) > 1 and key == 'detector':
        print('Behind ± is the standard deviation of the means of the seeds, which also differ in the headings.\n')
    print(common.format_table([*keys, 'views', *(f'{w}: {n}' for w in ways for n in ERROR_NAMES)], rows))


def print_poses(records: Records) -> None:
    """Print the mean errors of all frames in which the person truly is in a kind of pose."""
    ways, detectors = list_values(records, 'way'), list_values(records, 'detector')
    rows = []
    for pose in POSES:
        row: list[object] = [pose]
        for way in ways:
            for detector in detectors:
                mine = [r['poses'].get(pose, [0, 0, 0]) for r in select(records, way=way, detector=detector)]
                count, mpjpe, pa = (sum(m[i] for m in mine) for i in range(3))
                row.append(f'{mpjpe / count:.0f} / {pa / count:.0f}' if count else '-')
        rows.append([pose, count, *row[1:]])
    print('\n## By true pose, all frames: MPJPE / PA, mm\n')
    print(common.format_table(['pose', 'frames', *(f'{w}, {d}' for w in ways for d in detectors)], rows))


def print_comparison(records: Records, before: Records) -> None:
    """Print the mean changes since an earlier run over the views of both, with their standard errors."""
    keys = ('trial', 'detector', 'seed', 'heading', 'camera', 'frames', 'oracle', 'way')
    earlier = {tuple(r[k] for k in keys): r for r in before}
    pairs = [(r, earlier[name]) for r in records if (name := tuple(r[k] for k in keys)) in earlier]
    rows = []
    for detector, way in dict.fromkeys((r['detector'], r['way']) for r, _ in pairs):
        mine = [(r, b) for r, b in pairs if (r['detector'], r['way']) == (detector, way)]
        row: list[object] = [detector, way, len(mine)]
        for key, divisor in COMPARED.items():
            change = np.array([r[key] - b[key] for r, b in mine]) / divisor
            row.append(f'{change.mean():+.2f} ± {change.std() / np.sqrt(len(change)):.2f}')
        rows.append(row)
    print('\n## Change since the earlier run, with its standard error\n')
    print(common.format_table(['detector', 'way', 'views', 'MPJPE, mm', 'PA, mm', 'accel., m/s^2'], rows))


def measure_swaps(options: Sequence[ViewOptions], run: Measurement) -> Records:
    """Return the counts of swaps for each way and view."""
    records = []
    for chosen in common.show_progress(options, 'swaps'):
        seen = make_view(chosen)
        for way in run.ways:
            counts = count_swaps(seen.is_swapped, *find_exchanged(way, seen, run.models, run.config))
            records.append({**asdict(chosen), 'way': way, **counts})
    return records


def print_swaps(records: Records) -> None:
    rows = []
    for detector, way in dict.fromkeys((r['detector'], r['way']) for r in records):
        mine = select(records, detector=detector, way=way)
        frames = sum(r['frames'] for r in mine)
        longest, trial = max((r['longest wrong'], r['trial']) for r in mine)
        shares = [f'{100 * sum(r[k] for r in mine) / frames:.2f} %' for k in ('wrong', 'wrong without swap')]
        row: list[object] = [detector, way, frames, *shares, f'{longest} ({trial})']
        for kind in KINDS:
            n = {k: sum(r[kind][k] for r in mine) for k in mine[0][kind]}
            single = f'{n["single undone"]} of {n["single"]}'
            share = f'{100 * n["undone"] / n["frames"]:.0f} %' if n['frames'] else '-'
            row.append(f'{share} of {n["frames"]} frames, {n["swaps"]} swaps; {single}')
        rows.append(row)
    print(f'\n## Swaps: undone of those of {MIN_SWAP_FRAMES} frames and more; of single frames\n')
    print('A frame is wrong if a joint of the limbs is exchanged that the detector did not swap.\n')
    header = ['detector', 'way', 'frames', 'wrong', 'where none is', 'longest wrong, frames', *KINDS]
    print(common.format_table(header, rows))


def print_oracles(records: Records) -> None:
    """Print the errors under each oracle beside those with all of the detector's errors."""
    rows = []
    for oracle, detector in dict.fromkeys((r['oracle'], r['detector']) for r in records):
        row: list[object] = [detector, oracle or 'all errors of the detector']
        for way in list_values(records, 'way'):
            s = summarise(select(records, oracle=oracle, detector=detector, way=way))
            row.append(f'{s["mpjpe"]:.1f} / {s["pa"]:.1f} / {s["acceleration"]:.1f}')
        rows.append(row)
    rows.sort(key=lambda row: str(row[0]))
    print('\n## Oracles: MPJPE, mm / PA, mm / acceleration error, m/s^2\n')
    print(common.format_table(['detector', 'points', *list_values(records, 'way')], rows))


def measure_recordings(run: Measurement) -> Records:
    """Return the errors on the recorded detections, and those of MediaPipe's own 3D joints."""
    records = []
    for detector in RECORDED_DETECTORS:
        for camera in CAMERAS:
            file = common.data_path('data', 'detections', f'balance_{detector}_cam{camera}.npz')
            with np.load(file) as archive:
                sequence = {k: archive[k] for k in archive.files}
            recorded = load_sequence(file)
            sequence |= {'keypoints': recorded.keypoints, 'camera_matrix': recorded.camera_matrix}
            view = View(sequence)
            found = {way: (reconstruct(way, view, run.models, run.config), CMU15.joints) for way in run.ways}
            if detector == 'mediapipe':
                found["the detector's own 3D"] = sequence['mediapipe_world'].astype(float), view.joint_names
            records += [
                {'detector': detector, 'camera': camera, 'way': way, **common.compute_errors(view, *f, 'limbs')}
                for way, f in found.items()
            ]
    return records


def print_recordings(records: Records) -> None:
    rows = []
    for detector, way in dict.fromkeys((r['detector'], r['way']) for r in records):
        mine = select(records, detector=detector, way=way)
        cells = [[r[k] for k in ('mpjpe_mm', 'pa_mpjpe_mm')] for r in mine]
        cells.append(np.mean(cells, axis=0).tolist())
        acceleration = f'{common.mean_error(mine, "accel_mm_s2") / 1e3:.1f}'
        rows.append([detector, way, *('{:.1f} / {:.1f}'.format(*c) for c in cells), acceleration])
        rows[-1].append(sum(int(r['failed_frames']) for r in mine))
    print('\n## Recorded detections, 12 joints of the limbs: MPJPE / PA, mm; acceleration error, m/s^2\n')
    header = ['detector', 'result', *(f'camera {c}' for c in CAMERAS), 'mean', 'accel.', 'failed']
    print(common.format_table(header, rows))


def print_ghosts(found: Mapping[str, Mapping[str, Mapping[str, int]]]) -> None:
    first = next(iter(found.values()))['with ids']
    rows = [
        [detector, label, *n.values()]
        for detector, counts in found.items()
        for label, n in counts.items()
        if label != 'crossing'
    ]
    print('\n## Ghosts: person-frames published of people who are not there\n')
    print(common.format_table(['detector', 'people', *first], rows))
    for detector, counts in found.items():
        print('\n{}: {kept} of {pairs} crossing pairs keep their ids.'.format(detector, **counts['crossing']))


def load_models(shipped: bool, config: Config) -> tuple[Models, Config]:
    """Return base poses by name and the configuration with a lifter; where it names models, it has precedence."""
    common.choose_capture('motion')
    models: Models
    if shipped or config.tracker.model != AUTO:
        name = ALL_MOTIONS if config.tracker.model == AUTO else config.tracker.model
        models = load_base_pose_models(name)
    else:
        models = {ALL_MOTIONS: common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)}
    if not shipped and config.solver.prior == LEARNED:
        config = with_values(config, {'solver.prior': str(common.provide_held_out_lifter())})
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


def run_errors(run: Measurement) -> Records:
    trials = choose_trials(run.persons, run.trials_per_motion)
    errors = measure_errors(list_views(trials, run.detectors, run.frames, run.seeds), run.ways, run)
    for key in ('detector', 'category', 'camera'):
        print_errors(errors, key)
    print_poses(errors)
    if run.against:
        print_comparison(errors, json.loads(run.against.read_text(encoding='utf-8'))['errors'])
    return errors


def run_swaps(run: Measurement) -> Records:
    trials = choose_trials(run.persons, run.trials_per_motion, MIN_LONG_FRAMES)
    swaps = measure_swaps(list_views(trials, run.disturbed, max(run.frames, MIN_LONG_FRAMES), run.seeds), run)
    print_swaps(swaps)
    return swaps


def run_oracles(run: Measurement) -> Records:
    trials = choose_trials(run.persons, 1)
    options = [
        v for o in ('', *ORACLES) for v in list_views(trials, run.disturbed, QUICK_FRAMES, run.seeds[:1], o)
    ]
    errors = measure_errors(options, run.ways, run)
    print_oracles(errors)
    return errors


def run_own(run: Measurement) -> Records:
    options = list_views(choose_trials(run.persons, 1), run.detectors, QUICK_FRAMES, run.seeds[:1])
    errors = measure_own_base_poses(options, run.ways, run.models, run.config)
    print('\n## Base poses of the very person: MPJPE, mm; the ratio is the geometric mean over the views\n')
    header = ['detector', 'way', 'views', OWN, ALONE, NOT_GIVEN, 'own / pca']
    print(common.format_table(header, summarise_own(errors)))
    return errors


def run_recordings(run: Measurement) -> Records:
    errors = measure_recordings(run)
    print_recordings(errors)
    return errors


def run_ghosts(run: Measurement) -> dict[str, Any]:
    trials, found = choose_trials(run.persons, run.trials_per_motion, MIN_LONG_FRAMES), {}
    for detector in run.detectors:
        options = list_views(trials, [detector], max(run.frames, MIN_LONG_FRAMES), run.seeds[:1])
        views = [make_view(v) for v in options]
        found[detector] = measure_ghosts(views, run.models, run.config)
    print_ghosts(found)
    return found


def run_pictures(run: Measurement) -> None:
    options = list_views(choose_trials(run.persons, 1), run.disturbed, QUICK_FRAMES, run.seeds[:1])
    draw_cases(measure_errors(options, run.ways[:1], run), options, run.models, run.config, PICTURES)
    print(f'\nPictures: {PICTURES}')


def main() -> None:
    args = common.parse_arguments(__doc__, add_options, one_core=False)
    compile_kernels()
    run = choose_measurement(args)
    about = describe_models(run.models, run.config)
    print(f'# Detectors: {args.persons} persons\n\n{about}', flush=True)
    record: dict[str, Any] = {'models': about}
    wanted = args.only or (QUICK_SECTIONS if args.quick else SECTIONS)
    parts = {'errors' if s in WAYS else s: None for s in wanted}
    for name in parts:
        record[name] = RUNS[name](run)
        common.write_json(args.json, record)


RUNS: Mapping[str, Callable[[Measurement], Any]] = {
    'errors': run_errors,
    'swaps': run_swaps,
    'oracles': run_oracles,
    'own': run_own,
    'recordings': run_recordings,
    'ghosts': run_ghosts,
    'pictures': run_pictures,
}

if __name__ == '__main__':
    main()
