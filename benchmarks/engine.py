# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The engine: time of a frame by stage, how it grows, and the targets for speed and for the live result.

All times are for one core and one BLAS thread. Before each section the reference kernel is measured, by which runs
at different times and machines are compared. Sections of `--only`:

    stages   mean CPU time of one frame in the node by stage, beside those of version 0.1; a picture
    growth   CPU time of the tracker against people, window, base poses and frame rate; memory by person
    tracker  CPU time of the tracker by person and frame, and its longest single piece of work
    solver   one solution of 120 frames, and the comparison with scipy.optimize.least_squares
    node     latency and memory of the node over real DDS
    crowd    the largest number of people that the node tracks at 30 Hz (six minutes; not with --quick)
    start    time from the start of the node's process to its first answer, with a warm and with an empty cache
             (with --quick only the former)
    past     the live result against a solution from scratch of the same past (ten minutes; trains a lifter without
             the tested subjects if it is missing, half an hour)
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import common
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import solvers
from experiments import past_only
from experiments.node import HZ, MAX_PEOPLE, START_TIMEOUT_S, Peer, choose_domain, measure_usage, run_node
from experiments.stages import OTHER, STAGES, measure_stages
from matplotlib.figure import Figure
from numpy.typing import NDArray
from reconstruction import provide_held_out
from report import Record, Report, add_sections, group, run

from mocap_ros.config import Config, with_values
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

mpl.use('Agg')
Array = NDArray[np.float64]

BEFORE = Path(__file__).resolve().parent / 'history' / '0.1.0.json'  # what the releases are compared with
STAGE_PEOPLE = (1, 10, 30)  # crowds whose stages are measured
GROWTH_PEOPLE = (1, 2, 5, 10, 20, 30, 50)
GROWTH_TRIAL = '09_12'  # a walk of 16 s
CROWD_S = 60.0  # s for which a crowd must be tracked without a dropped frame
# Figures of the table of targets: the one to reach and the one beyond; True where more is better.
TARGETS: Mapping[str, tuple[float, float, bool]] = {
    'tracker_ms_person_frame_1': (1.0, 0.7, False),
    'tracker_ms_person_frame_10': (0.6, 0.4, False),
    'people_at_30hz': (30, 45, True),
    'latency_ms_p50_1': (4, 3, False),
    'latency_ms_p99_1': (12, 6, False),
    'latency_ms_p99_10': (33, 20, False),
    'longest_piece_ms': (3, 2, False),
    'solve_ms_120_frames': (30, 15, False),
    'times_faster_than_scipy': (15, 30, True),
    'live_over_past_only': (1.05, 1.0, False),
    'node_start_warm_s': (3, 2, False),
    'node_start_cold_s': (60, 30, False),
    'peak_mb': (260, 200, False),
}


def measure_all_stages(quick: bool) -> list[dict[str, Any]]:
    """Return the stages of each crowd in ms a frame and person, of the fastest of several runs."""
    frames, warm_up, repeats = (60, 20, 1) if quick else (240, HZ, 3)
    domain = choose_domain()
    rows = []
    for people in STAGE_PEOPLE[:2] if quick else STAGE_PEOPLE:
        runs = [measure_stages(domain, people, frames, warm_up) for _ in range(repeats)]
        fastest = min(runs, key=lambda stages: sum(stages.values()))
        whole = measure_stages(domain, people, frames, warm_up, {})[OTHER]
        by_person = {stage: ms / people for stage, ms in fastest.items()}
        rows.append(
            {'people': people, **by_person, 'sum': sum(by_person.values()), 'sum, unwrapped': whole / people}
        )
    return rows


def load_before() -> dict[str, Any]:
    """Return this benchmark's results of version 0.1, with the machine."""
    entry = json.loads(BEFORE.read_text(encoding='utf-8'))['engine']
    return {**entry['results'], 'machine': entry['machine']}


def show_stages(report: Report, rows: Sequence[Record], before: Record) -> None:
    """Show the stages as rows, and the crowds before and now as columns."""
    old = {r['people']: r for r in before.get('stages', ())}
    columns = {}
    for row in rows:
        if row['people'] in old:
            columns[f'{row["people"]}, before'] = old[row['people']]
        columns[f'{row["people"]}, now'] = row
    stages = [
        {'stage': stage, **{name: f'{found[stage]:.3f}' for name, found in columns.items()}}
        for stage in (*STAGES, OTHER, 'sum', 'sum, unwrapped')
    ]
    report.rows('Mean CPU time of one frame in the node, ms by person', stages, page='engine.stages')
    report.text(f'Before: {before["machine"]}')


def draw_stages(rows: Sequence[Record], before: Record) -> Figure:
    """Draw the stages of each crowd as stacked bars, before and now side by side."""
    figure, axes = plt.subplots(figsize=(7, 4), layout='constrained')
    colours = plt.colormaps['tab20'](np.linspace(0, 1, 20))
    old = {r['people']: r for r in before.get('stages', ())}
    ticks: list[float] = []
    labels: list[str] = []
    for place, row in enumerate(rows):
        for offset, when, found in ((-0.2, 'before', old.get(row['people'])), (0.2, 'now', row)):
            if found is None:
                continue
            bottom = 0.0
            for stage, colour in zip((*STAGES, OTHER), colours, strict=False):
                name = stage if not ticks else None
                axes.bar(place + offset, found[stage], 0.36, bottom, color=colour, label=name)
                bottom += found[stage]
            axes.text(place + offset, bottom, f'{bottom:.2f}', ha='center', va='bottom', fontsize=8)
            ticks.append(place + offset)
            labels.append(f'{row["people"]}\n{when}')
    axes.set_xticks(ticks, labels)
    axes.set(xlabel='people', ylabel='CPU time by person and frame, ms')
    figure.legend(*axes.get_legend_handles_labels(), loc='outside right upper', frameon=False, reverse=True)
    return figure


def report_stages(report: Report, quick: bool) -> dict[str, Any]:
    rows, before = measure_all_stages(quick), load_before()
    show_stages(report, rows, before)
    if not quick:
        report.picture(draw_stages(rows, before), 'docs/img/engine/stages.png')
    return {'stages': rows}


def make_stream(people: int, rate: float, frames: int) -> list[list[Person2D]]:
    """Return the frames of people who walk side by side, each seen from another side, at a rate in Hz.

    The people are 1.5 m apart, and further crowds of twelve stand in the same places with other names.
    """
    views = common.make_views(GROWTH_TRIAL, np.arange(12) * 30, frames=480)
    times = views[0].sequence['timestamps']
    at = np.arange(frames) / rate
    tracks = []
    for number in range(people):
        points = views[number % 12].window.points.reshape(len(times), -1)
        sampled = np.stack([np.interp(at, times, column) for column in points.T], axis=-1).reshape(frames, -1, 2)
        tracks.append(sampled + [common.load_protocol().PX_PER_M * 1.5 * number, 0.0])
    score = np.ones(len(CMU15.joints))
    return [[Person2D(f'p{n}', CMU15.joints, t[f], score) for n, t in enumerate(tracks)] for f in range(frames)]


def measure_tracker(
    people: int, rate: float = 30.0, seconds: float = 8.0, repeats: int = 1, **values: Any
) -> dict[str, float]:
    """Measure the CPU time of the tracker by person and frame, of the fastest of several runs.

    Args:
        people: number of people; all of them appear in the first frame.
        rate: Hz.
        seconds: s, length of the stream; the first third does not count, but for the longest pieces of work.
        repeats: number of runs.
        values: parameters of the tracker.
    """
    config = with_values(Config(), {f'tracker.{name}': value for name, value in values.items()})
    frames = make_stream(people, rate, round(seconds * rate))
    (view,) = common.make_views(GROWTH_TRIAL, [0], frames=1)
    runs = [_measure_stream(frames, rate, config, view) for _ in range(repeats)]
    return min(runs, key=lambda run: run['median ms'])


def _measure_stream(
    frames: Sequence[Sequence[Person2D]], rate: float, config: Config, view: common.View
) -> dict[str, float]:
    tracker = Tracker(load_base_pose_models(config.tracker.model), config)
    people, updates, pieces = len(frames[0]), [], []
    for number, seen in enumerate(frames):
        start_s = time.thread_time()
        tracker.update(round(number / rate * NS_PER_S) + 1, seen, view.intrinsics)
        between_s = time.thread_time()
        tracker.run_deferred_work()
        updates.append((between_s - start_s) * 1e3)
        pieces.append((time.thread_time() - between_s) * 1e3)
    update, piece = np.array(updates), np.array(pieces)
    late = slice(len(frames) // 3, None)
    return {
        'median ms': float(np.median(update[late])) / people,
        'p99 ms': float(np.percentile(update[late], 99)) / people,
        'mean ms with deferred work': float((update + piece)[late].mean()) / people,
        'first update, ms': float(update[0]),
        'longest update, ms': float(update.max()),
        'longest deferred piece, ms': float(piece.max()),
    }


def report_growth(report: Report, quick: bool) -> dict[str, Any]:
    """Measure the tracker against people, window, base poses and frame rate, one at a time, and its memory."""
    seconds = 2.0 if quick else 8.0
    windows, components = ((1.0,), (20,)) if quick else ((0.5, 1.0, 2.0, 4.0, 8.0), (5, 10, 20, 30, 39))
    crowds, rates = (GROWTH_PEOPLE[:3:2], (60.0,)) if quick else (GROWTH_PEOPLE, (15.0, 30.0, 60.0))
    one = {'people': 1, 'seconds': seconds}
    cases: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = {
        'people': [({'people': n}, one | {'people': n}) for n in crowds],
        'window': [({'window s': w}, one | {'window': w, 'seconds': seconds + w}) for w in windows],
        'base poses': [({'K': k}, one | {'components': k}) for k in components],
        'rate': [({'rate Hz': r}, one | {'rate': r}) for r in rates],
    }
    growth = {}
    for name, rows in cases.items():
        shown = common.show_progress(rows, name)
        growth[name] = [{**label, **measure_tracker(**options)} for label, options in shown]
        report.rows(f'CPU time of the tracker by person and frame, against {name}', growth[name])
    memory = measure_memory_by_person(quick)
    report.text(f'Memory that the tracker keeps: {memory["memory_kb_person"]:.0f} kB by person')
    return {'growth': growth, **memory}


def measure_memory_by_person(quick: bool) -> dict[str, float]:
    """Return the memory that a tracker keeps for each person, kB: the difference of two crowds, full windows."""
    few, many = (1, 5) if quick else (1, 31)
    kept = [_measure_kept_bytes(people) for people in (few, many)]
    return {'memory_kb_person': (kept[1] - kept[0]) / (many - few) / 1e3}


def _measure_kept_bytes(people: int) -> int:
    frames = make_stream(people, 30.0, 75)
    (view,) = common.make_views(GROWTH_TRIAL, [0], frames=1)
    tracker = Tracker(load_base_pose_models('auto'), Config())
    tracemalloc.start()
    for number, seen in enumerate(frames):
        tracker.update(round(number / 30 * NS_PER_S) + 1, seen, view.intrinsics)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return kept


def measure_targets_of_tracker(report: Report, quick: bool) -> dict[str, Any]:
    seconds, repeats = (3.0, 1) if quick else (8.0, 3)
    found = {people: measure_tracker(people, seconds=seconds, repeats=repeats) for people in (1, 10)}
    rows = [{'people': n, **r} for n, r in found.items()]
    report.rows('CPU time of the tracker by person and frame, defaults', rows, page='engine.tracker')
    return {
        'tracker': {str(n): r for n, r in found.items()},
        **{f'tracker_ms_person_frame_{n}': r['median ms'] for n, r in found.items()},
        'longest_piece_ms': max(r['longest deferred piece, ms'] for r in found.values()),
    }


def measure_targets_of_solver(report: Report, quick: bool) -> dict[str, Any]:
    config = common.make_config(components=solvers.TARGET_COMPONENTS)
    one = solvers.measure_solver([solvers.WALK.window], solvers.WALK.model, config, 5 if quick else 25)
    setting = next(iter(solvers.SCIPY_OPTIONS))
    cases = solvers.CASES[:1] if quick else solvers.CASES
    records = [solvers.compare_with_scipy(c, [setting], 3 if quick else 9) for c in cases]
    solvers.show_scipy(report, records)
    report.text(f'120 frames, K = {solvers.TARGET_COMPONENTS}, one start: {one["ms"]:.1f} ms')
    by_scipy = [r['scipy'][setting] for r in records]
    ratios = [r['times faster'] for r in by_scipy]
    to_its_optimum = min(r.get('times faster to its optimum', float('nan')) for r in by_scipy)
    return {
        'solve_ms_120_frames': one['ms'],
        'times_faster_than_scipy': min(ratios),
        'times_faster_than_scipy_most': max(ratios),
        'times_faster_than_scipy_to_its_optimum': to_its_optimum,
        'scipy': records,
    }


def measure_targets_of_node(_report: Report, quick: bool) -> dict[str, Any]:
    """Measure the latency of crowds who appear at once, CPU and memory; for one person without the first 2 s."""
    out: dict[str, Any] = {}
    seconds, streams = (3.0, 1) if quick else (20.0, 3)
    peer = Peer(choose_domain())
    try:
        with tempfile.TemporaryDirectory() as name, run_node(Path(name)) as process:
            peer.wait_for_node()
            for people in (1, 10) if quick else (1, 5, 10):
                cpu_s, start_s = measure_usage(process)[0], time.perf_counter()
                warm_up = 2.0 if people == 1 else 0.0
                found = [peer.stream(people, seconds, warm_up) for _ in range(streams)]
                share = (measure_usage(process)[0] - cpu_s) / (time.perf_counter() - start_s)
                latency, missing = np.concatenate([f[0] for f in found]), sum(f[1] for f in found)
                first = np.concatenate([f[0][:HZ] for f in found])
                out |= {
                    f'latency_ms_p50_{people}': float(np.percentile(latency, 50)),
                    f'latency_ms_p99_{people}': float(np.percentile(latency, 99)),
                    f'latency_ms_max_{people}': float(latency.max()),
                    f'latency_ms_p99_{people}_first_second': float(np.percentile(first, 99)),
                    f'dropped_{people}': missing,
                    f'cpu_percent_{people}': 100 * share,
                }
            out['peak_mb'] = measure_usage(process)[1]
    finally:
        peer.close()
    return out


def measure_people_at_30hz(_report: Report, quick: bool) -> dict[str, Any]:
    """Find the largest crowd whose frames are all answered for `CROWD_S`, by bisection."""
    if quick:
        return {}
    sustained, failed = 0, MAX_PEOPLE + 1
    peer = Peer(choose_domain())
    try:
        with tempfile.TemporaryDirectory() as name, run_node(Path(name)):
            peer.wait_for_node()
            while failed - sustained > 1:
                people = (sustained + failed) // 2
                _, missing = peer.stream(people, CROWD_S, 0.0)
                sustained, failed = (sustained, people) if missing else (people, failed)
    finally:
        peer.close()
    return {'people_at_30hz': sustained, 'people_at_30hz_s': CROWD_S}


def measure_start(peer: Peer, cache: Path | None) -> float:
    """Return the time in s from the start of the node's process to its first answer.

    Args:
        peer: sends a person at `HZ` until an answer arrives.
        cache: folder in which the node keeps its compiled functions; None for the usual one.
    """
    peer.arrived.clear()
    messages = peer.encode_stream(1)
    start_s = time.perf_counter()
    environment = {} if cache is None else {'NUMBA_CACHE_DIR': str(cache)}
    with tempfile.TemporaryDirectory() as name, run_node(Path(name), **environment):
        while not peer.arrived:
            if time.perf_counter() - start_s > START_TIMEOUT_S:
                raise TimeoutError
            peer.keypoints.publish(next(messages)[1])
            peer.spin_until(time.perf_counter() + 1 / HZ)
        return min(peer.arrived.values()) - start_s


def measure_starts(_report: Report, quick: bool) -> dict[str, Any]:
    peer = Peer(choose_domain())
    try:
        if quick:
            return {'node_start_warm_s': measure_start(peer, None)}
        with tempfile.TemporaryDirectory() as cache:
            cold = measure_start(peer, Path(cache))
            warm = [measure_start(peer, Path(cache)) for _ in range(5)]
    finally:
        peer.close()
    return {'node_start_cold_s': cold, 'node_start_warm_s': float(np.median(warm))}


def report_past(report: Report, quick: bool) -> dict[str, Any]:
    found = past_only.compare_all(*provide_held_out(), quick)
    out: dict[str, Any] = {'live_over_past_only': past_only.compute_ratio(found)}
    for attribute in ('detector', 'category', 'camera'):
        rows = [
            {
                attribute: name,
                'views': len(mine),
                'live, mm': common.mean_error(mine, 'live'),
                'from scratch, mm': common.mean_error(mine, 'scratch'),
                'live / from scratch': past_only.compute_ratio(mine),
            }
            for (name,), mine in group(found, attribute).items()
        ]
        report.rows(f'Live result and solution from scratch of the same past, by {attribute}', rows)
        out[f'live_over_past_only_by_{attribute}'] = {r[attribute]: r['live / from scratch'] for r in rows}
    return out | {'past': found}


SECTIONS: Mapping[str, Callable[[Report, bool], dict[str, Any]]] = {
    'stages': report_stages,
    'growth': report_growth,
    'tracker': measure_targets_of_tracker,
    'solver': measure_targets_of_solver,
    'node': measure_targets_of_node,
    'crowd': measure_people_at_30hz,
    'start': measure_starts,
    'past': report_past,
}


def format_verdict(key: str, value: float) -> str:
    reach, beyond, is_more_better = TARGETS[key]
    if (value >= beyond) if is_more_better else (value <= beyond):
        return 'beyond'
    return 'reached' if ((value >= reach) if is_more_better else (value <= reach)) else 'not reached'


def measure(args: argparse.Namespace, report: Report) -> None:
    common.choose_capture('motion')
    reference_s, found = {}, report.results
    for section in args.only or SECTIONS:
        reference_s[section] = common.measure_reference_kernel_s()
        report.text(f'Reference kernel before section {section}: {reference_s[section]:.3f} s')
        report.add(**SECTIONS[section](report, args.quick), reference_s=reference_s)
    before = load_before()
    rows = [
        [key, before.get(key), f'{found[key]:.3g}', reach, beyond, format_verdict(key, found[key])]
        for key, (reach, beyond, _) in TARGETS.items()
        if key in found
    ]
    header = ['quantity', 'version 0.1', 'now', 'reach', 'beyond', 'verdict']
    report.table(header, rows, 'Targets', page='engine.targets')


if __name__ == '__main__':
    run(__doc__, 'The engine', measure, lambda p: add_sections(p, SECTIONS))
