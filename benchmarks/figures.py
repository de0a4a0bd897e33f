# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run the benchmarks, keep what they measured in one record, and write it into the pages.

Commands:

    run [NAME ...]    run the benchmarks whose entries are missing or stale, one after the other, and write the
                      pages. Each finished benchmark is in the record at once: the same command goes on after an
                      interruption. With --quick in their short form, which takes minutes and whose results go into
                      build/figures/quick.json and into no page.
    enter NAME FILE   enter what a benchmark wrote with --json FILE, and write the pages
    keep NAME ...     enter tables by hand as the pages show them, with the command that measured them
    confirm NAME ...  state that benchmarks measure what they did, though their own files were changed since
    write             write the pages from the record, as the commands above do, and draw how the figures went
    check             find tables and pictures that differ from the record; with --release, stale ones as well
    release VERSION   keep the record as history/VERSION.json, and draw how the figures went
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from typing import Any

from figure_record import (
    RECORD,
    Benchmark,
    confirm_entry,
    find_cell,
    find_differences,
    hash_file,
    list_stale,
    list_unmarked,
    load_record,
    put_entry,
    read_table,
    save_record,
    write_pages,
)

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path('build', 'figures')  # what the benchmarks print and write
QUICK_RECORD = BUILD / 'quick.json'  # the record of short runs, which no page shows
HISTORY = Path('benchmarks', 'history')
PACKAGES = ('mocap_ros', 'numpy', 'scipy', 'numba', 'matplotlib')  # whose versions are recorded
LOG_LINES = 20  # of a benchmark that failed, which are shown
MAX_RESULT_CHARACTERS = (
    20_000  # of one result in the record; longer ones, such as records of every view, are not kept
)
PICTURE_OF_HISTORY = Path('docs', 'img', 'figures', 'history.png')

PROTOCOL = 'bench/protocol.py'
CMU = (PROTOCOL, 'data/cmu/cmu15_30fps.npz', 'data/cmu/manifest.csv')
MOTION = (PROTOCOL, 'data/motion/body26_30fps.npz', 'data/motion/manifest.csv')
DETECTIONS = tuple(f'data/detections/balance_{d}_cam{c}.npz' for d in ('mediapipe', 'openpose') for c in (1, 2, 3))
MODELS = 'base_poses', 'lifter', 'lifter_input', 'network', 'upward_direction'  # that solvers use
GEOMETRY = (  # all that solvers and tracker use; `level` serves the exports and the view alone
    *('camera_jacobian', 'distortion', 'interpolation', 'intrinsics'),
    *('rigid_transform', 'rotations', 'virtual_camera', 'weak_perspective'),
)
SOLVERS = (
    *(f'mocap_ros/{f}' for f in ('config/defaults.py', 'solvers', 'training/fit_base_poses.py')),
    *(f'mocap_ros/geometry/{f}.py' for f in GEOMETRY),
    *(f'mocap_ros/models/{f}.py' for f in MODELS),
)
TRACKER = (*SOLVERS, *(f'mocap_ros/{f}' for f in ('compiled', 'keypoints', 'models', 'offline', 'tracking')))
HELD_OUT = 'benchmarks/models/lifter_heldout.npz'
BAGS = ('mocap_ros/bags', 'mocap_ros/messages', 'mocap_ros/runtime')
# Sections of `paper.py`, which are measured one by one, with their modules.
PAPER_SECTIONS = {
    **dict.fromkeys(('table1', 'base_poses', 'beta', 'bones', 'norms'), 'accuracy'),
    **dict.fromkeys(('cameras', 'flips', 'differences'), 'cameras'),
    **dict.fromkeys(('sines', 'classification', 'claims'), 'gait'),
    **dict.fromkeys(('convergence', 'noisy_starts', 'initial_cameras', 'hidden', 'missing', 'noise'), 'stability'),
    'weights': 'stability',
    'targets': 'targets',
}
# Sections of `detectors.py`, which take an hour and more together, by the names of their entries.
DETECTOR_SECTIONS = {
    'points': ('whole', 'live'),
    **{s: (s,) for s in ('swaps', 'oracles', 'fixed', 'own', 'recordings', 'ghosts', 'extremities', 'pictures')},
}

BENCHMARKS = (
    Benchmark('table1', 'table1.py', SOLVERS, CMU),
    *(
        Benchmark(
            f'paper.{section}',
            'paper.py',
            TRACKER if module == 'targets' else SOLVERS,
            (*CMU, *(DETECTIONS if module == 'targets' else ())),
            ('--only', section),
            part=f'experiments/{module}.py',
        )
        for section, module in PAPER_SECTIONS.items()
    ),
    Benchmark('classification', 'classification.py', ('benchmarks/periodic_labels.csv', *SOLVERS), CMU),
    Benchmark('solvers', 'solvers.py', SOLVERS, CMU),
    Benchmark('lifter', 'lifter.py', (*SOLVERS, HELD_OUT), (*MOTION, *DETECTIONS)),
    Benchmark('tracker', 'tracker.py', (*TRACKER, HELD_OUT), MOTION),
    Benchmark('keyframes', 'keyframes.py', (*TRACKER, HELD_OUT), (*CMU, *DETECTIONS)),
    *(
        Benchmark(
            f'detectors.{name}',
            'detectors.py',
            (*TRACKER, HELD_OUT),
            (*MOTION, *DETECTIONS) if name == 'recordings' else MOTION,
            ('--only', *sections),
            ('--seeds', '0', '--detectors', 'mediapipe'),
        )
        for name, sections in DETECTOR_SECTIONS.items()
    ),
    Benchmark(
        'vertical',
        'vertical.py',
        (*TRACKER, HELD_OUT),
        MOTION,
        ('--detectors', 'mediapipe', '--elevations', '20', '--frames', '120'),
    ),
    Benchmark('engine', 'engine.py', (*TRACKER, HELD_OUT, *BAGS, 'mocap_ros/ros'), MOTION),
    Benchmark('faults', 'faults.py', (*BAGS, 'mocap_ros/ros'), (PROTOCOL,)),
    Benchmark('overload', 'overload.py', ('mocap_ros/ros', 'mocap_ros/runtime/pipeline.py'), (PROTOCOL,)),
    Benchmark('soak', 'soak.py', ('mocap_ros/bags', 'mocap_ros/ros'), (PROTOCOL,)),
    Benchmark(
        'corpora',
        'corpora.py',
        (*BAGS, 'mocap_ros/batch'),
        (PROTOCOL,),
        ('--bags', '10', '--task-seconds', '6'),
    ),
    Benchmark('robots', 'robots.py', ('mocap_ros/bridges', 'mocap_ros/messages', *TRACKER, HELD_OUT), MOTION),
    Benchmark('recording', 'recording.py', (*BAGS, 'mocap_ros/ros/live.py'), (PROTOCOL,)),
    # The last, since it also shows what others have measured.
    Benchmark(
        'readme',
        'readme.py',
        (
            *TRACKER,
            HELD_OUT,
            'mocap_ros/demo',
            *(f'benchmarks/{f}' for f in ('experiments', 'paper.py', 'table1.py')),
        ),
        (*CMU, *MOTION, *DETECTIONS),
    ),
)
# What the picture of the history shows: title, table, beginnings of the row in any release, and column in any.
TABLE_1_ROWS = {
    m: tuple(f'{m} | category | joint solver{n}' for n in (', defaults', ' as it'))
    for m in ('walk', 'run', 'jump')
}
HEADLINES: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    *((f'{m}, clean points: MPJPE, mm', 'paper.table1', r, 'joint: MPJPE, mm') for m, r in TABLE_1_ROWS.items()),
    ('recorded OpenPose: MPJPE, mm', 'lifter.detections', ('openpose, both',), 'mean'),
    ('recorded MediaPipe: MPJPE, mm', 'lifter.detections', ('mediapipe, both',), 'mean'),
    ('tracker, one person: ms', 'engine.targets', ('tracker, one', 'tracker_ms_person_frame_1 '), 'now'),
)


def run_benchmarks(chosen: Sequence[Benchmark], root: Path, *, quick: bool, again: bool = False) -> int:
    """Run benchmarks and record what they measured; return how many failed or measured nothing."""
    path = root / (QUICK_RECORD if quick else RECORD)
    failed = 0
    for number, benchmark in enumerate(chosen, 1):
        record, sums = load_record(path), hash_data(benchmark, root)
        before = record.get(benchmark.name, {})
        if not again and before.get('sources') == benchmark.hash_sources(root) and before.get('data') == sums:
            print(f'{number}/{len(chosen)} {benchmark.name}: up to date', flush=True)
            continue
        print(f'{number}/{len(chosen)} {benchmark.name}: running', flush=True)
        entry = run_benchmark(benchmark, root, quick=quick)
        if entry is None:
            failed += 1
            continue
        save_record(put_entry(load_record(path), benchmark.name, {**entry, 'data': sums}), path)
        print(f'    {entry["seconds"]:.0f} s, {len(entry["tables"])} tables', flush=True)
    return failed


def run_benchmark(benchmark: Benchmark, root: Path, *, quick: bool) -> dict[str, Any] | None:
    """Run one benchmark; return its entry, or None, with a message, if it failed or measured nothing."""
    folder = root / BUILD / ('quick' if quick else 'full')
    folder.mkdir(parents=True, exist_ok=True)
    output, log = folder / f'{benchmark.name}.json', folder / f'{benchmark.name}.log'
    output.unlink(missing_ok=True)
    options = [*benchmark.options, *(['--quick', *benchmark.quick_options] if quick else [])]
    command = [sys.executable, str(root / 'benchmarks' / benchmark.script), *options, '--json', str(output)]
    sources, begun = benchmark.hash_sources(root), time.monotonic()
    with log.open('w', encoding='utf-8') as file:
        status = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, cwd=root, check=False).returncode
    if status or not output.is_file():
        lines = log.read_text(encoding='utf-8', errors='replace').splitlines()[-LOG_LINES:]
        print('\n'.join(f'    {line}' for line in lines))
        print(f'    {f"failed with status {status}" if status else "measured nothing"}: {log}', flush=True)
        return None
    found = json.loads(output.read_text(encoding='utf-8'))
    return {
        'command': ' '.join([f'benchmarks/{benchmark.script}', *options]),
        'finished': datetime.now(timezone.utc).isoformat(timespec='seconds'),
        'seconds': round(time.monotonic() - begun, 1),
        'sources': sources,
        'package': benchmark.hash_sources(root, only_package=True),
        **describe_results(found, root),
    }


def describe_results(found: Mapping[str, Any], root: Path) -> dict[str, Any]:
    """Return the part of an entry that follows from the JSON of a benchmark and from where it runs."""
    about = ('begun', 'command', 'machine', 'pictures', 'quick', 'tables', 'results')
    text = json.dumps(found.get('results', {k: v for k, v in found.items() if k not in about}))
    results = json.loads(
        re.sub(r'(/[\w.+-]+)+/(?=(build|mocap_ros|benchmarks)/)', '', text)
    )  # no path of the machine
    return {
        'commit': describe_commit(root),
        'machine': found.get('machine', platform.platform()),
        'pictures': {p: hash_file(root / p) for p in found.get('pictures', [])},
        'results': {k: v for k, v in results.items() if len(json.dumps(v)) <= MAX_RESULT_CHARACTERS},
        'tables': found.get('tables', {}),
        'versions': {'python': platform.python_version(), **list_versions()},
    }


def enter(benchmark: Benchmark, file: Path, root: Path) -> None:
    """Enter the results of a run; they are stale at once if what they measure changed after the run began.

    Raises:
        ValueError: the file is not of a whole run.
    """
    found = json.loads(file.read_text(encoding='utf-8'))
    if found.get('quick') is not False:
        raise ValueError(f'{file}: these are not the results of a full run')
    changed = [f for f in benchmark.list_sources(root) if f.stat().st_mtime > found['begun']]
    for path in changed:
        print(f'changed since the run began: {path.relative_to(root)}')
    is_package_changed = any(not path.is_relative_to(root / 'benchmarks') for path in changed)
    entry = {
        'command': found['command'],
        'data': hash_data(benchmark, root),
        'finished': datetime.fromtimestamp(file.stat().st_mtime, timezone.utc).isoformat(timespec='seconds'),
        'seconds': round(file.stat().st_mtime - found['begun'], 1),
        'sources': '' if changed else benchmark.hash_sources(root),
        'package': '' if is_package_changed else benchmark.hash_sources(root, only_package=True),
        **describe_results(found, root),
    }
    save_record(put_entry(load_record(root / RECORD), benchmark.name, entry), root / RECORD)


def keep(
    names: Sequence[str], command: str, benchmarks: Sequence[Benchmark], root: Path, *, once: bool = False
) -> None:
    """Enter tables by hand as the pages show them, into the entry that their names begin with.

    Args:
        names: of the tables.
        command: that measured them.
        benchmarks: that the tables depend on; they are stale when one of these changes.
        root: of the repository.
        once: whether they were measured to choose a setting, and are never stale.
    """
    record = load_record(root / RECORD)
    about: dict[str, Any] = {'by': 'hand', 'command': command, 'commit': describe_commit(root)}
    about['finished'] = datetime.now(timezone.utc).isoformat(timespec='seconds')
    if once:
        about['once'] = True
    else:
        about['sources'] = {b.name: b.hash_sources(root) for b in benchmarks}
        about['package'] = {b.name: b.hash_sources(root, only_package=True) for b in benchmarks}
    for name in names:
        entry = record.setdefault(_find_entry(name), {})
        entry.get('tables', {}).pop(name, None)
        entry.setdefault('kept', {})[name] = {**about, 'text': read_table(name, root)}
    save_record(record, root / RECORD)


def confirm(benchmarks: Sequence[Benchmark], because: str, root: Path) -> None:
    """Enter that the results of benchmarks are as before, though their own files have changed, and why.

    Raises:
        ValueError: the package has changed since they were measured.
    """
    record = load_record(root / RECORD)
    for benchmark in benchmarks:
        said = {'because': because, 'commit': describe_commit(root)}
        entry = record[benchmark.name]
        if 'sources' in entry:
            entry = confirm_entry(entry, benchmark, root)
        kept = {
            name: confirm_entry(table, benchmark, root) if benchmark.name in table.get('sources', {}) else table
            for name, table in entry.get('kept', {}).items()
        }
        record[benchmark.name] = {**entry, 'kept': kept, 'confirmed': [*entry.get('confirmed', []), said]}
    save_record(record, root / RECORD)


def _find_entry(table: str) -> str:
    """Return the benchmark with the longest name that a table's name begins with, or else its first word."""
    found = [b.name for b in BENCHMARKS if f'{table}.'.startswith(f'{b.name}.')]
    return max(found, key=len, default=table.partition('.')[0])


def hash_data(benchmark: Benchmark, root: Path) -> dict[str, str | None]:
    """Return the checksums of the evaluation data of a benchmark; None for a file that is missing."""
    folder = Path(os.environ.get('MOCAP_ROS_SHARED') or root.parent / 'shared')
    return {name: hash_file(folder / name) if (folder / name).is_file() else None for name in benchmark.data}


@cache
def list_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on."""
    installed = importlib.metadata.packages_distributions()
    return {name: importlib.metadata.version(installed[name][0]) for name in PACKAGES if name in installed}


def describe_commit(root: Path) -> str:
    """Return the commit, with `+` if files differ from it; empty outside a repository."""

    def ask(*words: str) -> str:
        return subprocess.run(['git', *words], cwd=root, capture_output=True, text=True, check=True).stdout.strip()

    try:
        return ask('rev-parse', 'HEAD') + '+' * bool(ask('status', '--porcelain'))
    except (OSError, subprocess.CalledProcessError):
        return ''


def check(benchmarks: Sequence[Benchmark], root: Path, *, release: bool) -> int:
    """Print what differs from the record and what is stale; return 1 if something must be done about it."""
    record = load_record(root / RECORD)
    differences, stale = find_differences(record, root), list_stale(record, benchmarks, root)
    for line in differences:
        print(line)
    if differences:
        print('nobody edits these by hand: `make figures` measures and writes them')
    if stale:
        print(f'stale, since what they measure has changed: {", ".join(stale)}')
    unmarked = list_unmarked(root) if release else []
    for line in unmarked:
        print(line)
    missing = [b.name for b in benchmarks if 'sources' not in record.get(b.name, {})]
    if release and missing:
        print(f'never measured: {", ".join(missing)}')
    return int(bool(differences or (release and (stale or missing or unmarked))))


def keep_release(benchmarks: Sequence[Benchmark], root: Path, version: str) -> int:
    """Keep the record of a release and draw the history; return 1 if the record is not fit for a release."""
    if check(benchmarks, root, release=True):
        return 1
    save_record(load_record(root / RECORD), root / HISTORY / f'{version}.json')
    draw_history(load_history(root / HISTORY), root / PICTURE_OF_HISTORY)
    return 0


def load_history(folder: Path) -> dict[str, dict[str, Any]]:
    """Load the records of the releases, in the order of their versions."""
    files = sorted(folder.glob('*.json'), key=lambda f: [int(n) for n in f.stem.split('.')])
    return {f.stem: load_record(f) for f in files}


def find_headline(record: Mapping[str, Any], table: str, rows: Sequence[str], column: str) -> float:
    """Return the first number of a cell of a table; NaN where the record has none there."""
    numbers = re.findall(r'\d+(?:\.\d+)?', find_cell(record, table, rows, column))
    return float(numbers[0]) if numbers else float('nan')


def draw_history(history: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Draw the headlines of the releases."""
    from panels import make_panels

    figure, axes = make_panels(3, rows=2, height=4.0)
    for ax, (title, table, rows, column) in zip(axes.flat, HEADLINES, strict=True):
        values = [find_headline(r, table, rows, column) for r in history.values()]
        ax.plot(list(history), values, 'o-', color='#0072b2')
        for x, y in zip(history, values, strict=True):
            ax.annotate(f'{y:g}', (x, y), (0, -11), textcoords='offset points', ha='center', fontsize=8)
        ax.set_title(title, loc='left')
        ax.set(ylim=(0, 1.2 * max([v for v in values if v > 0], default=1.0)), xlim=(-0.4, len(history) - 0.6))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={'Software': None})


def main() -> int:
    names = {b.name: b for b in BENCHMARKS}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest='command', required=True)
    run = commands.add_parser('run', help='run benchmarks')
    run.add_argument('names', nargs='*', metavar='NAME', help=f'of {", ".join(names)}; all by default')
    run.add_argument('--quick', action='store_true', help='run the short form of each benchmark')
    run.add_argument('--again', action='store_true', help='run also what is up to date')
    commands.add_parser('write', help='write the pages')
    entering = commands.add_parser('enter', help='enter the results of a run')
    entering.add_argument('name', choices=names, metavar='NAME', help='of the benchmark')
    entering.add_argument('file', type=Path, metavar='FILE', help='that the benchmark wrote with --json')
    keeping = commands.add_parser('keep', help='enter tables by hand as the pages show them')
    keeping.add_argument('names', nargs='+', metavar='NAME', help='between the markers of the page')
    keeping.add_argument('--command', dest='measured_by', required=True, help='command that measured them')
    origin = keeping.add_mutually_exclusive_group(required=True)
    origin.add_argument(
        '--of', nargs='+', choices=names, default=[], metavar='BENCHMARK', help='that it belongs to'
    )
    origin.add_argument('--once', action='store_true', help='measured to choose a setting, and never stale')
    confirming = commands.add_parser('confirm', help='state that results are as before')
    confirming.add_argument('names', nargs='+', choices=names, metavar='NAME', help='of the benchmarks')
    confirming.add_argument('--because', required=True, help='how it is known that the results are the same')
    checking = commands.add_parser('check', help='compare the pages with the record')
    checking.add_argument('--release', action='store_true', help='fail also if something is stale or missing')
    release = commands.add_parser('release', help='keep the record of a release')
    release.add_argument('version', help='such as 0.3.0')
    args = parser.parse_args()
    match args.command:
        case 'run':
            unknown = sorted(set(args.names) - set(names))
            if unknown:
                parser.error(f'there is no benchmark {", ".join(unknown)}')
            chosen = [names[n] for n in args.names or names]
            failed = run_benchmarks(chosen, ROOT, quick=args.quick, again=args.again)
            if not args.quick:
                write(ROOT)
            return min(failed, 1)
        case 'enter' | 'keep' | 'confirm':
            try:
                if args.command == 'enter':
                    enter(names[args.name], args.file, ROOT)
                elif args.command == 'confirm':
                    confirm([names[n] for n in args.names], args.because, ROOT)
                else:
                    keep(args.names, args.measured_by, [names[n] for n in args.of], ROOT, once=args.once)
            except (OSError, ValueError) as error:
                parser.error(str(error))
            write(ROOT)
        case 'write':
            write(ROOT)
        case 'check':
            return check(BENCHMARKS, ROOT, release=args.release)
        case _:
            return keep_release(BENCHMARKS, ROOT, args.version)
    return 0


def write(root: Path) -> None:
    """Write the pages from the record, print which of them changed, and draw how the figures went."""
    record = load_record(root / RECORD)
    draw_history({**load_history(root / HISTORY), 'now': record}, root / PICTURE_OF_HISTORY)
    for page in write_pages(record, list_stale(record, BENCHMARKS, root), root):
        print(f'written: {page.relative_to(root)}')


if __name__ == '__main__':
    sys.exit(main())
